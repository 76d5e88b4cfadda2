//! The objective: loss and gradient as functions of the unknowns.

use super::exposure::{self, Exposure, Sensor};
use super::flow;
use super::loss::PictureLoss;
use super::parameters::{Parameters, Pose, Shown};
use super::regulariser::Regularisers;
use super::renderer::{RenderError, Renderer};
use super::target::Target;
use antirad_base::parallel;
use antirad_core::plan::GradientRequest;
use antirad_render::render::{Quantity, SceneGradient};
use antirad_scene::Scene;
use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::Arc;

/// The objective: the weighted mean of the losses of all views, plus the regularisers.
pub struct Problem {
    /// Maps unknowns to a scene and pulls derivatives back.
    pub parameters: Parameters,
    /// One target per view.
    pub targets: Vec<Target>,
    /// Loss of a picture against its target.
    pub loss: Arc<dyn PictureLoss + Send + Sync>,
    /// The regularisers.
    pub regularisers: Regularisers,
}

/// Value and gradient of the objective at a point.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// Loss including regularisers.
    pub value: f64,
    /// Derivatives by the unknowns.
    pub gradient: Vec<f64>,
    /// Loss per view, before weights.
    pub views: Vec<f64>,
    /// Value per regulariser, with its weight; at the end that of responses, if they are unknown.
    pub assumptions: Vec<f64>,
}

/// Value of the objective at a point, with scene and pictures but without the gradient.
#[derive(Clone, Debug)]
pub struct Judged {
    /// The scene at that point.
    pub scene: Scene,
    /// Pictures, per view, W/(m² sr).
    pub pictures: Vec<Vec<DVec3>>,
    /// What makes the numbers of each target from radiance.
    pub sensors: Vec<Sensor>,
    /// Loss including regularisers.
    pub value: f64,
    /// Loss per view, before weights.
    pub views: Vec<f64>,
    /// Value per regulariser, with its weight; at the end that of responses, if they are unknown.
    pub assumptions: Vec<f64>,
}

/// Derivatives of a picture by an unknown, per channel; empty where it changes nothing.
type Slope = [Vec<f32>; 3];

/// The same per view.
type Slopes = Vec<Slope>;

/// Step of finite differences, in units of the unknowns' scale: balances truncation error against rounding in f32.
const DIFFERENCE: f64 = 1e-3;

/// Step of the forward differences of a Gauss-Newton Hessian, in units of the unknowns' scale, but for those of cameras.
const COLUMN_STEP: f64 = 1e-2;

impl Problem {
    /// The weight of each view's loss; they sum to 1.
    pub(super) fn weights(&self) -> Vec<f64> {
        let sum: f64 = self.targets.iter().map(|t| t.weight).sum();
        self.targets.iter().map(|t| t.weight / sum).collect()
    }

    /// Gains and responses of each view, see [`exposure`]; the usual ones where the loss is not smooth, which
    /// [`Job::new`](super::Job::new) refuses.
    pub(super) fn sensors(&self, pictures: &[Vec<DVec3>]) -> Vec<Sensor> {
        let sensors = exposure::sensors(&self.targets, pictures, &*self.loss);
        sensors.unwrap_or_else(|| self.targets.iter().map(Sensor::usual).collect())
    }

    /// Loss of the pictures per view and in total, and derivatives by pixels, with the sensor of each view.
    pub(super) fn compare(
        &self,
        pictures: &[Vec<DVec3>],
        sensors: &[Sensor],
    ) -> (Vec<f64>, f64, Vec<Vec<DVec3>>) {
        let mut views = Vec::with_capacity(pictures.len());
        let mut by_pixels = Vec::with_capacity(pictures.len());
        let mut sum = 0.0;
        let exposed = exposed(pictures, sensors);
        for (view, ((picture, target), weight)) in
            exposed.iter().zip(&self.targets).zip(self.weights()).enumerate()
        {
            let (value, mut gradient) = self.loss.evaluate(view, picture, target);
            let slopes = sensors[view].slopes(&pictures[view]);
            gradient.iter_mut().zip(slopes).for_each(|(g, slope)| *g *= weight * slope);
            sum += weight * value;
            views.push(value);
            by_pixels.push(gradient);
        }
        (views, sum, by_pixels)
    }

    /// Loss and gradient. The value is NaN if the scene has no solution.
    ///
    /// # Errors
    /// Fails if pictures or their derivatives cannot be rendered, except for a scene without solution.
    pub fn evaluate(&self, x: &[f64], renderer: &mut dyn Renderer) -> Result<Evaluation, RenderError> {
        let scene = self.parameters.scene(x);
        let pictures = match renderer.pictures(&scene) {
            Ok(pictures) => pictures,
            Err(RenderError::NoAnswer(reason)) => {
                tracing::debug!("a step is refused: {reason}");
                return Ok(Evaluation {
                    value: f64::NAN,
                    gradient: vec![0.0; x.len()],
                    views: vec![f64::NAN; self.targets.len()],
                    assumptions: Vec::new(),
                });
            }
            Err(error) => return Err(error),
        };
        let sensors = self.sensors(&pictures);
        let (views, loss, by_pixels) = self.compare(&pictures, &sensors);
        let request = self.parameters.gradient_request();
        let (mut by_scene, mut gradient) = match renderer.pull_back(&by_pixels, request)? {
            Some(by_scene) => (by_scene, vec![0.0; x.len()]),
            None => {
                let differences = self.differences(x, &by_pixels, renderer)?;
                (SceneGradient::zeros(&scene, request), differences)
            }
        };
        let mut assumptions =
            self.regularisers.evaluate(&self.parameters, &scene, x, &mut by_scene, &mut gradient);
        assumptions.extend(exposure::unlike_srgb(&self.targets, &sensors));
        let pulled = self.parameters.pull_back(x, &by_scene);
        gradient.iter_mut().zip(pulled).for_each(|(g, p)| *g += p);
        let value = loss + assumptions.iter().sum::<f64>();
        Ok(Evaluation { value, gradient, views, assumptions })
    }

    /// Evaluates a point without its gradient.
    ///
    /// # Errors
    /// Fails if the pictures cannot be rendered, or if the scene has no solution.
    pub fn judge(&self, x: &[f64], renderer: &mut dyn Renderer) -> Result<Judged, RenderError> {
        let scene = self.parameters.scene(x);
        let pictures = renderer.pictures(&scene)?;
        let sensors = self.sensors(&pictures);
        let (views, loss, _) = self.compare(&pictures, &sensors);
        let (mut nowhere, mut direct) = (SceneGradient::default(), vec![0.0; x.len()]);
        let mut assumptions =
            self.regularisers.evaluate(&self.parameters, &scene, x, &mut nowhere, &mut direct);
        assumptions.extend(exposure::unlike_srgb(&self.targets, &sensors));
        let value = loss + assumptions.iter().sum::<f64>();
        Ok(Judged { scene, pictures, sensors, value, views, assumptions })
    }

    /// The unknowns with all emission scaled by one factor per channel, that which explains pictures of known exposure best. Pictures are
    /// linear in emission, so that one rendering tells it.
    ///
    /// # Errors
    /// Fails if the pictures cannot be rendered, or if the scene has no solution.
    pub fn scaled_emission(&self, x: &[f64], renderer: &mut dyn Renderer) -> Result<Vec<f64>, RenderError> {
        let mut scaled = x.to_vec();
        if self.targets.iter().any(|target| target.exposure.is_fitted()) {
            // The gains take the factor.
            return Ok(scaled);
        }
        let pictures = renderer.pictures(&self.parameters.scene(x))?;
        let shared = Exposure { gain: true, white_balance: true, shared: Some(0) };
        let known = |target: &Target| Target { response: None, ..target.clone().exposed(shared) };
        let targets: Vec<Target> = self.targets.iter().map(known).collect();
        let sensors = exposure::sensors(&targets, &pictures, &*self.loss);
        let factor = sensors.and_then(|sensors| Some(sensors.first()?.gain));
        if let Some(factor) = factor.filter(|factor| factor.is_finite() && factor.min_element() > 0.0) {
            let emission = self.parameters.unknowns_of(Quantity::Emission);
            for (k, unknown) in emission.into_iter().enumerate() {
                scaled[unknown] *= factor[k % 3];
            }
            self.parameters.bounds().project(&mut scaled);
        }
        Ok(scaled)
    }

    /// The gradient of the pictures' loss by central differences: two renderings per unknown.
    fn differences(
        &self,
        x: &[f64],
        by_pixels: &[Vec<DVec3>],
        renderer: &mut dyn Renderer,
    ) -> Result<Vec<f64>, RenderError> {
        let bounds = self.parameters.bounds();
        let steps = self.parameters.steps(DIFFERENCE);
        let mut gradient = Vec::with_capacity(x.len());
        for i in 0..x.len() {
            let ends = [(x[i] - steps[i]).max(bounds.lower[i]), (x[i] + steps[i]).min(bounds.upper[i])];
            if ends[1] <= ends[0] {
                gradient.push(0.0);
                continue;
            }
            let mut at = |end: f64| {
                let mut moved = x.to_vec();
                moved[i] = end;
                renderer.pictures(&self.parameters.scene(&moved))
            };
            let (below, above) = (at(ends[0])?, at(ends[1])?);
            gradient.push((product(by_pixels, &above) - product(by_pixels, &below)) / (ends[1] - ends[0]));
        }
        Ok(gradient)
    }

    /// The product of the Hessian with `p`. Requires pictures linear in the unknowns and a quadratic loss.
    ///
    /// # Errors
    /// Fails if the loss is not quadratic, or if pictures or their derivatives cannot be rendered.
    pub fn curvature(&self, p: &[f64], renderer: &mut dyn Renderer) -> Result<Vec<f64>, RenderError> {
        let refuse = |message: &str| RenderError::Failed(message.into());
        let scene = self.parameters.linear_scene(p);
        let mut by_pixels = renderer.pictures_of_difference(&scene)?;
        for (view, ((picture, target), weight)) in
            by_pixels.iter_mut().zip(&self.targets).zip(self.weights()).enumerate()
        {
            let curvature = self.loss.curvature(view, picture, target).filter(|_| self.loss.is_quadratic());
            let curvature =
                curvature.ok_or_else(|| refuse("this loss is not quadratic; use another optimiser"))?;
            picture.iter_mut().zip(curvature).for_each(|(v, c)| *v *= weight * c);
        }
        let request = self.parameters.gradient_request();
        let mut product_of = match renderer.pull_back(&by_pixels, request)? {
            Some(by_scene) => self.parameters.pull_back(p, &by_scene),
            None => {
                let mut by_unknowns = Vec::with_capacity(p.len());
                for i in 0..p.len() {
                    let mut unit = vec![0.0; p.len()];
                    unit[i] = 1.0;
                    let column = renderer.pictures_of_difference(&self.parameters.linear_scene(&unit))?;
                    by_unknowns.push(product(&by_pixels, &column));
                }
                by_unknowns
            }
        };
        // Regularisers are at most quadratic in emission: their Hessian product is a difference of gradients.
        let gradient = |x: &[f64]| self.gradient_of_regularisers(&self.parameters.linear_scene(x), x);
        let change: Vec<f64> = difference(&gradient(p), &gradient(&vec![0.0; p.len()]));
        product_of.iter_mut().zip(change).for_each(|(h, c)| *h += c);
        Ok(product_of)
    }

    fn gradient_of_regularisers(&self, scene: &Scene, x: &[f64]) -> Vec<f64> {
        self.regularised(scene, x).1
    }

    /// Value and gradient of the regularisers.
    fn regularised(&self, scene: &Scene, x: &[f64]) -> (f64, Vec<f64>) {
        let mut by_scene = SceneGradient::zeros(scene, self.parameters.gradient_request());
        let mut by_unknowns = vec![0.0; x.len()];
        let values = self.regularisers.evaluate(&self.parameters, scene, x, &mut by_scene, &mut by_unknowns);
        let pulled = self.parameters.pull_back(x, &by_scene);
        (values.iter().sum(), by_unknowns.iter().zip(pulled).map(|(a, b)| a + b).collect())
    }

    /// Value and gradient of the regularisers by the unknowns `own` of a pose, with everything else where it starts.
    pub(super) fn regularised_pose(&self, pose: &Pose, own: &DVector<f64>) -> (f64, DVector<f64>) {
        if self.regularisers.is_empty() {
            return (0.0, DVector::zeros(own.len()));
        }
        let mut x = self.parameters.start().to_vec();
        x[pose.unknowns.clone()].copy_from_slice(own.as_slice());
        let (value, gradient) = self.regularised(&self.parameters.scene(&x), &x);
        (value, DVector::from_column_slice(&gradient[pose.unknowns.clone()]))
    }

    /// The diagonal of the Gauss-Newton Hessian of the pictures, with the light that arrives at surfaces held fixed: most of it
    /// where each unknown is the albedo or emission of few triangles, or of a camera. With `far_reaching`, that of lamps,
    /// if these are few, takes a picture per view for each; the rest takes no solve beside that at the point itself.
    /// `None` if the loss is not quadratic, something else is unknown, or the renderer does not know.
    ///
    /// # Errors
    /// Fails if the pictures cannot be rendered, or if the scene has no solution.
    pub fn own_curvature(
        &self,
        x: &[f64],
        far_reaching: bool,
        renderer: &mut dyn Renderer,
    ) -> Result<Option<Vec<f64>>, RenderError> {
        let pictures = renderer.pictures(&self.parameters.scene(x))?;
        let sensors = self.sensors(&pictures);
        let here = exposed(&pictures, &sensors).into_owned();
        let Some(weights) = self.curvatures(&here) else { return Ok(None) };
        let by_radiance = |((weights, sensor), picture): ((&Vec<DVec3>, &Sensor), &Vec<DVec3>)| {
            weights
                .iter()
                .zip(sensor.slopes(picture))
                .map(|(weight, slope)| *weight * slope * slope)
                .collect()
        };
        let by_radiance: Vec<Vec<DVec3>> =
            weights.iter().zip(&sensors).zip(&pictures).map(by_radiance).collect();
        let squares =
            renderer.own_squares(&by_radiance).and_then(|squares| self.parameters.own_squares(&squares));
        let Some(mut squares) = squares else { return Ok(None) };
        let columns = if far_reaching { self.parameters.far_reaching_columns() } else { Vec::new() };
        for column in columns {
            let Some(slopes) = self.slopes(x, &column, &here, renderer)? else { return Ok(None) };
            for (unknown, slopes) in slopes {
                squares[unknown] = weighted_product(&slopes, &slopes, &weights);
            }
        }
        Ok(Some(squares))
    }

    /// Curvatures of the loss by the pixels of exposed pictures, per view; `None` if it is not smooth.
    fn curvatures(&self, exposed: &[Vec<DVec3>]) -> Option<Vec<Vec<DVec3>>> {
        let views = self.targets.iter().zip(self.weights()).enumerate();
        let weighted = |(view, (target, weight)): (usize, (&Target, f64))| {
            let curvature = self.loss.curvature(view, &exposed[view], target)?;
            Some(curvature.into_iter().map(|c| weight * c).collect())
        };
        views.map(weighted).collect()
    }

    /// Pictures per view that [`Self::gauss_newton`] takes, beside that at the point itself: none for poses of cameras.
    pub fn gauss_newton_pictures(&self) -> usize {
        self.parameters.columns().iter().filter(|column| !column.iter().all(Shown::is_of_views)).count()
    }

    /// The Gauss-Newton Hessian JᵀWJ, row by row, with W the loss's second derivatives by pixels, plus that of the
    /// regularisers. The columns of J come from forward differences, each of one picture per view; it is meant as a model
    /// of the curvature, not as an exact derivative. Those of cameras come from optical flow, and take none. `None` if the loss is not quadratic, or a step of the differences has no
    /// picture.
    ///
    /// # Errors
    /// Fails if the pictures cannot be rendered, or if the scene at `x` has no solution.
    pub fn gauss_newton(
        &self,
        x: &[f64],
        renderer: &mut dyn Renderer,
    ) -> Result<Option<Vec<f64>>, RenderError> {
        let n = x.len();
        let steps = self.steps_into_room(x);
        let per_unknown = |change: f64, i: usize| if steps[i] == 0.0 { 0.0 } else { change / steps[i] };
        let pictures = renderer.pictures(&self.parameters.scene(x))?;
        let here = exposed(&pictures, &self.sensors(&pictures)).into_owned();
        let Some(weights) = self.curvatures(&here) else { return Ok(None) };
        let mut columns: Vec<Slopes> = vec![Slopes::new(); n];
        for column in self.parameters.columns() {
            let Some(slopes) = self.slopes(x, &column, &here, renderer)? else { return Ok(None) };
            slopes.into_iter().for_each(|(unknown, slopes)| columns[unknown] = slopes);
        }
        let row = |i: usize| -> Vec<f64> {
            (0..=i).map(|j| weighted_product(&columns[i], &columns[j], &weights)).collect()
        };
        let rows: Vec<Vec<f64>> = parallel::map(0..n, row);
        let mut hessian = vec![0.0; n * n];
        for (i, row) in rows.iter().enumerate() {
            for (j, entry) in row.iter().enumerate() {
                (hessian[i * n + j], hessian[j * n + i]) = (*entry, *entry);
            }
        }
        let gradient = |x: &[f64]| self.gradient_of_regularisers(&self.parameters.scene(x), x);
        let at_x = gradient(x);
        for i in 0..n {
            let mut moved = x.to_vec();
            moved[i] += steps[i];
            let change = difference(&gradient(&moved), &at_x);
            for (j, change) in change.iter().enumerate() {
                hessian[i * n + j] += 0.5 * per_unknown(*change, i);
                hessian[j * n + i] += 0.5 * per_unknown(*change, i);
            }
        }
        Ok(Some(hessian))
    }

    /// Steps of forward differences, into the room that there is; 0 for an unknown without room, which is fixed.
    fn steps_into_room(&self, x: &[f64]) -> Vec<f64> {
        let bounds = self.parameters.bounds();
        let into_room = |(i, step): (usize, f64)| match () {
            () if x[i] + step <= bounds.upper[i] => step,
            () if x[i] - step >= bounds.lower[i] => -step,
            () => 0.0,
        };
        self.parameters.steps(COLUMN_STEP).into_iter().enumerate().map(into_room).collect()
    }

    /// Derivatives of the exposed pictures by the unknowns of a column, by forward differences from the exposed pictures `here`. `None` if
    /// there are no pictures at the end of the step.
    fn slopes(
        &self,
        x: &[f64],
        column: &[Shown],
        here: &[Vec<DVec3>],
        renderer: &mut dyn Renderer,
    ) -> Result<Option<Vec<(usize, Slopes)>>, RenderError> {
        let steps = self.steps_into_room(x);
        let mut moved = x.to_vec();
        column.iter().for_each(|shown| moved[shown.unknown] += steps[shown.unknown]);
        let there = match self.turned(column, [x, &moved], renderer)? {
            Some(pictures) => pictures,
            None => match renderer.pictures_near(&self.parameters.scene(&moved)) {
                Err(RenderError::NoAnswer(_)) => return Ok(None),
                pictures => pictures?,
            },
        };
        // Gains and responses are found again, whose part in the derivatives is thereby projected out.
        let there = exposed(&there, &self.sensors(&there)).into_owned();
        let slopes = |shown: &Shown| {
            let step = steps[shown.unknown];
            let of_channel = |view: usize, c: usize| {
                let changes = shown.changes(view) && shown.channel.is_none_or(|only| only == c);
                let pixels = here[view].iter().zip(&there[view]).filter(|_| changes && step != 0.0);
                pixels.map(|(a, b)| ((b[c] - a[c]) / step) as f32).collect()
            };
            let of_view = |view: usize| [0, 1, 2].map(|c| of_channel(view, c));
            (shown.unknown, (0..here.len()).map(of_view).collect())
        };
        Ok(Some(column.iter().map(slopes).collect()))
    }
}

impl Problem {
    /// The derivative by the unknowns of poses of a loss of the latest pictures, and zero by others; `None` if the renderer does not know.
    pub(super) fn by_poses(
        &self,
        x: &[f64],
        by_pixels: &[Vec<DVec3>],
        renderer: &mut dyn Renderer,
    ) -> Result<Option<Vec<f64>>, RenderError> {
        let by_scene = renderer.pull_back(by_pixels, GradientRequest::NOTHING.camera(true))?;
        Ok(by_scene.map(|by_scene| self.parameters.pull_back(x, &by_scene)))
    }

    /// The Gauss-Newton Hessian by the unknowns of each pose, see [`Self::gauss_newton`], under the first of these; `None` if the loss is not smooth.
    pub(super) fn curvatures_by_poses(
        &self,
        x: &[f64],
        pictures: &[Vec<DVec3>],
        sensors: &[Sensor],
        renderer: &mut dyn Renderer,
    ) -> Result<Option<HashMap<usize, DMatrix<f64>>>, RenderError> {
        let here = exposed(pictures, sensors).into_owned();
        let Some(weights) = self.curvatures(&here) else { return Ok(None) };
        let mut columns = HashMap::new();
        for column in self.parameters.columns().iter().filter(|column| column.iter().all(Shown::is_of_views))
        {
            let Some(slopes) = self.slopes(x, column, &here, renderer)? else { return Ok(None) };
            columns.extend(slopes);
        }
        let of_pose = |pose: Pose| {
            let first = pose.unknowns.start;
            let columns: Vec<&Slopes> =
                pose.unknowns.clone().filter_map(|unknown| columns.get(&unknown)).collect();
            let product = |i: usize, j: usize| weighted_product(columns[i], columns[j], &weights);
            let mut curvature = DMatrix::from_fn(columns.len(), columns.len(), product);
            let own = DVector::from_column_slice(&x[pose.unknowns.clone()]);
            let (_, gradient) = self.regularised_pose(&pose, &own);
            for i in 0..own.len() {
                let mut moved = own.clone();
                moved[i] += COLUMN_STEP;
                let (_, there) = self.regularised_pose(&pose, &moved);
                curvature.column_mut(i).axpy(1.0 / COLUMN_STEP, &(there - &gradient), 1.0);
            }
            (first, curvature)
        };
        Ok(Some(parallel::map(self.parameters.poses(), of_pose).into_iter().collect()))
    }

    /// The pictures at the end of a step from the latest ones where the unknowns of the column are of cameras alone, by optical flow;
    /// `None` for others, and if the renderer does not know what pixels show.
    fn turned(
        &self,
        column: &[Shown],
        [x, moved]: [&[f64]; 2],
        renderer: &mut dyn Renderer,
    ) -> Result<Option<Vec<Vec<DVec3>>>, RenderError> {
        if !column.iter().all(Shown::is_of_views) {
            return Ok(None);
        }
        let [from, to] = [x, moved].map(|x| self.parameters.scene(x));
        let pictures = renderer.pictures(&from)?;
        let Some(points) = renderer.points_in_pixels() else { return Ok(None) };
        let of_view =
            |view: usize| flow::moved(&pictures[view], &points[view], &from.cameras[view], &to.cameras[view]);
        Ok(Some(parallel::map(0..pictures.len(), of_view)))
    }
}

/// The sum over pixels of the product of two derivatives and a weight.
fn weighted_product(a: &Slopes, b: &Slopes, weights: &[Vec<DVec3>]) -> f64 {
    let channel = |a: &[f32], b: &[f32], weights: &[DVec3], c: usize| {
        let product = |((a, b), weight): ((&f32, &f32), &DVec3)| f64::from(*a) * f64::from(*b) * weight[c];
        a.iter().zip(b).zip(weights).map(product).sum::<f64>()
    };
    let view = |((a, b), weights): ((&Slope, &Slope), &Vec<DVec3>)| {
        (0..3).map(|c| channel(&a[c], &b[c], weights, c)).sum::<f64>()
    };
    a.iter().zip(b).zip(weights).map(view).sum()
}

/// Pictures in the numbers of their targets.
fn exposed<'a>(pictures: &'a [Vec<DVec3>], sensors: &[Sensor]) -> Cow<'a, [Vec<DVec3>]> {
    if sensors.iter().all(Sensor::is_identity) {
        return Cow::Borrowed(pictures);
    }
    Cow::Owned(parallel::map(pictures.iter().zip(sensors), |(picture, sensor)| sensor.numbers(picture)))
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn product(a: &[Vec<DVec3>], b: &[Vec<DVec3>]) -> f64 {
    let view = |(a, b): (&Vec<DVec3>, &Vec<DVec3>)| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
    a.iter().zip(b).map(view).sum()
}
