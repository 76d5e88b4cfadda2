//! From unknowns to loss and gradient.

use super::gradient::SceneGradient;
use super::loss::PictureLoss;
use super::parameters::Parameters;
use super::regulariser::Regularisers;
use super::renderer::{RenderError, Renderer};
use super::target::Target;
use crate::scene::Scene;
use glam::DVec3;

/// What is minimised: the weighted mean of the losses of all views, plus the assumptions.
pub struct Problem {
    /// From unknowns to a scene, and back for derivatives.
    pub parameters: Parameters,
    /// One for each view.
    pub targets: Vec<Target>,
    /// How far a picture is from its target.
    pub loss: Box<dyn PictureLoss + Send>,
    /// The assumptions.
    pub regularisers: Regularisers,
}

/// What an evaluation found.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// Loss and assumptions.
    pub value: f64,
    /// By the unknowns.
    pub gradient: Vec<f64>,
    /// Before weights.
    pub views: Vec<f64>,
    /// With their weights.
    pub assumptions: Vec<f64>,
}

/// A point without its gradient, but with all there is to see of it.
#[derive(Clone, Debug)]
pub struct Judged {
    /// At that point.
    pub scene: Scene,
    /// By view.
    pub pictures: Vec<Vec<DVec3>>,
    /// Loss and assumptions.
    pub value: f64,
    /// Losses of the pictures, before weights.
    pub views: Vec<f64>,
    /// With their weights.
    pub assumptions: Vec<f64>,
}

/// Step of finite differences, in units of the unknowns' scale: a compromise between the curvature of the loss and the
/// rounding of f32.
const DIFFERENCE: f64 = 1e-3;

impl Problem {
    /// The weight of each view's loss: they add up to 1.
    fn weights(&self) -> Vec<f64> {
        let sum: f64 = self.targets.iter().map(|t| t.weight).sum();
        self.targets.iter().map(|t| t.weight / sum).collect()
    }

    /// The loss of pictures by view, in all, and derivatives by pixels.
    fn compare(&self, pictures: &[Vec<DVec3>]) -> (Vec<f64>, f64, Vec<Vec<DVec3>>) {
        let mut views = Vec::with_capacity(pictures.len());
        let mut by_pixels = Vec::with_capacity(pictures.len());
        let mut sum = 0.0;
        for (view, ((picture, target), weight)) in
            pictures.iter().zip(&self.targets).zip(self.weights()).enumerate()
        {
            let (value, mut gradient) = self.loss.evaluate(view, picture, target);
            gradient.iter_mut().for_each(|g| *g *= weight);
            sum += weight * value;
            views.push(value);
            by_pixels.push(gradient);
        }
        (views, sum, by_pixels)
    }

    /// Loss and gradient. A scene without an answer has the value NaN.
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
        let (views, loss, by_pixels) = self.compare(&pictures);
        let wanted = self.parameters.wanted();
        let (mut by_scene, mut gradient) = match renderer.pull_back(&by_pixels, wanted)? {
            Some(by_scene) => (by_scene, vec![0.0; x.len()]),
            None => {
                let differences = self.differences(x, &by_pixels, renderer)?;
                (SceneGradient::zeros(&scene, wanted), differences)
            }
        };
        let assumptions =
            self.regularisers.evaluate(&self.parameters, &scene, x, &mut by_scene, &mut gradient);
        let pulled = self.parameters.pull_back(x, &by_scene);
        gradient.iter_mut().zip(pulled).for_each(|(g, p)| *g += p);
        let value = loss + assumptions.iter().sum::<f64>();
        Ok(Evaluation { value, gradient, views, assumptions })
    }

    /// Looks at a point.
    pub fn judge(&self, x: &[f64], renderer: &mut dyn Renderer) -> Result<Judged, RenderError> {
        let scene = self.parameters.scene(x);
        let pictures = renderer.pictures(&scene)?;
        let (views, loss, _) = self.compare(&pictures);
        let (mut nowhere, mut direct) = (SceneGradient::default(), vec![0.0; x.len()]);
        let assumptions = self.regularisers.evaluate(&self.parameters, &scene, x, &mut nowhere, &mut direct);
        let value = loss + assumptions.iter().sum::<f64>();
        Ok(Judged { scene, pictures, value, views, assumptions })
    }

    /// The gradient of the pictures' loss by differences of pictures: two renders an unknown.
    fn differences(
        &self,
        x: &[f64],
        by_pixels: &[Vec<DVec3>],
        renderer: &mut dyn Renderer,
    ) -> Result<Vec<f64>, RenderError> {
        let bounds = self.parameters.bounds();
        let mut gradient = Vec::with_capacity(x.len());
        for i in 0..x.len() {
            let ends = [(x[i] - DIFFERENCE).max(bounds.lower[i]), (x[i] + DIFFERENCE).min(bounds.upper[i])];
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

    /// The product of the Hessian with `p`, where pictures are linear in the unknowns and the loss is quadratic.
    pub fn curvature(&self, p: &[f64], renderer: &mut dyn Renderer) -> Result<Vec<f64>, RenderError> {
        let refuse = |message: &str| RenderError::Failed(message.into());
        let scene = self.parameters.linear_scene(p);
        let mut by_pixels = renderer.pictures(&scene)?;
        for (view, ((picture, target), weight)) in
            by_pixels.iter_mut().zip(&self.targets).zip(self.weights()).enumerate()
        {
            let curvature = self.loss.curvature(view, target);
            let curvature =
                curvature.ok_or_else(|| refuse("this loss is not quadratic: take another optimiser"))?;
            picture.iter_mut().zip(curvature).for_each(|(v, c)| *v *= weight * c);
        }
        let wanted = self.parameters.wanted();
        let mut product_of = match renderer.pull_back(&by_pixels, wanted)? {
            Some(by_scene) => self.parameters.pull_back(p, &by_scene),
            None => {
                let mut by_unknowns = Vec::with_capacity(p.len());
                for i in 0..p.len() {
                    let mut unit = vec![0.0; p.len()];
                    unit[i] = 1.0;
                    let column = renderer.pictures(&self.parameters.linear_scene(&unit))?;
                    by_unknowns.push(product(&by_pixels, &column));
                }
                by_unknowns
            }
        };
        // Assumptions are quadratic or linear in emissions: their Hessian is the change of their gradient.
        let change: Vec<f64> = {
            let gradient = |x: &[f64]| {
                let scene = self.parameters.linear_scene(x);
                let mut by_scene = SceneGradient::zeros(&scene, wanted);
                let mut by_unknowns = vec![0.0; x.len()];
                self.regularisers.evaluate(&self.parameters, &scene, x, &mut by_scene, &mut by_unknowns);
                let pulled = self.parameters.pull_back(x, &by_scene);
                by_unknowns.iter().zip(pulled).map(|(a, b)| a + b).collect::<Vec<f64>>()
            };
            let nothing = gradient(&vec![0.0; p.len()]);
            gradient(p).iter().zip(nothing).map(|(a, b)| a - b).collect()
        };
        product_of.iter_mut().zip(change).for_each(|(h, c)| *h += c);
        Ok(product_of)
    }
}

fn product(a: &[Vec<DVec3>], b: &[Vec<DVec3>]) -> f64 {
    let view = |(a, b): (&Vec<DVec3>, &Vec<DVec3>)| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
    a.iter().zip(b).map(view).sum()
}
