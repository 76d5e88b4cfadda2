//! Derivatives of a loss, by the adjoint of the light equation.

use crate::direct::Lamp;
use crate::engine::{Engine, EngineError, Solution, SolveParams, check_position, power_of_two, rounding};
use crate::model::FacetGradient;
use crate::plan::{GradientRequest, PADDING, PlannedSolver};
use crate::solve::{FixedPointParams, GmresParams, SolveInfo, SolveProgress, fixed_point, gmres};
use crate::transport::LobeSums;
use antirad_base::setters;
use antirad_scene::Scene;
use glam::DVec3;
use std::f64::consts::PI;
use std::ops::ControlFlow;

/// Derivatives of a loss with respect to the results of a solve: RGB, per triangle of the scene. A loss may depend on
/// several of them; `None` stands for zeros.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct Cotangent {
    /// Derivative by [`Solution::irradiance`], per W/m².
    pub irradiance: Option<Vec<DVec3>>,
    /// Derivative by the irradiance that comes straight from lamps, per W/m².
    pub direct_irradiance: Option<Vec<DVec3>>,
    /// Derivative by the rest of the irradiance, the indirect part, per W/m².
    pub indirect_irradiance: Option<Vec<DVec3>>,
    /// Derivative by [`Solution::radiosity`], per W/m².
    pub radiosity: Option<Vec<DVec3>>,
    /// Derivative by [`Engine::face_colours`], per W/(m² sr), for each camera position, metres.
    pub colours: Vec<(DVec3, Vec<DVec3>)>,
    /// Derivative by the face colours without the highlights of lamps, per W/(m² sr), for each camera
    /// position, metres.
    pub colours_without_highlights: Vec<(DVec3, Vec<DVec3>)>,
    /// Derivative by the specular radiance of each triangle per bin, per W/(m² sr). Empty for triangles on
    /// whose specular radiance the loss does not depend.
    pub specular_radiance: Option<Vec<Vec<DVec3>>>,
}

setters!(Cotangent {
    irradiance: Option<Vec<DVec3>>,
    direct_irradiance: Option<Vec<DVec3>>,
    indirect_irradiance: Option<Vec<DVec3>>,
    radiosity: Option<Vec<DVec3>>,
    colours: Vec<(DVec3, Vec<DVec3>)>,
    colours_without_highlights: Vec<(DVec3, Vec<DVec3>)>,
    specular_radiance: Option<Vec<Vec<DVec3>>>,
});

/// Derivatives of a loss with respect to the parameters of a scene; `None` for those not requested.
#[derive(Clone, Debug)]
pub struct Gradients {
    /// With respect to L_e, RGB, per triangle. Triangles without area have zero everywhere.
    pub emission: Option<Vec<DVec3>>,
    /// With respect to the irradiance of each sun, RGB, per W/m²; requested with emission.
    pub suns: Option<Vec<DVec3>>,
    /// With respect to the diffuse constant δ, per triangle.
    pub diffuse: Option<Vec<f64>>,
    /// With respect to the albedo ρ, RGB, per triangle.
    pub albedo: Option<Vec<DVec3>>,
    /// With respect to the specular constant σ, RGB, per triangle; zero where no lobe was planned.
    pub specular: Option<Vec<DVec3>>,
    /// With respect to the power p, per triangle; zero where no lobe was planned.
    pub power: Option<Vec<f64>>,
    /// With respect to the corners of each triangle, as if no two triangles shared a vertex, per metre.
    pub corners: Option<Vec<[DVec3; 3]>>,
    /// With respect to each vertex of the scene, per metre.
    pub vertices: Option<Vec<DVec3>>,
    /// With respect to each camera of [`Cotangent::colours`], then of those without highlights, per metre.
    pub camera_positions: Option<Vec<DVec3>>,
    /// How the adjoint solve went.
    pub info: SolveInfo,
}

impl Cotangent {
    /// The colours towards cameras, with highlights and then without.
    pub(crate) fn views(&self) -> impl Iterator<Item = &(DVec3, Vec<DVec3>)> {
        self.colours.iter().chain(&self.colours_without_highlights)
    }

    fn values(&self) -> impl Iterator<Item = &Vec<DVec3>> {
        let irradiance = [&self.irradiance, &self.direct_irradiance, &self.indirect_irradiance];
        irradiance
            .into_iter()
            .flatten()
            .chain(&self.radiosity)
            .chain(self.views().map(|(_, values)| values))
            .chain(self.specular_radiance.iter().flatten())
    }

    /// The power of two at or below the largest entry.
    fn steepness(&self) -> f64 {
        power_of_two(self.values().flatten().map(|v| v.abs().max_element()).fold(0.0, f64::max))
    }

    fn divided(&self, by: f64) -> Self {
        let values = |values: &Vec<DVec3>| values.iter().map(|&v| v / by).collect();
        let views = |views: &[(DVec3, Vec<DVec3>)]| {
            views.iter().map(|(camera_position, colours)| (*camera_position, values(colours))).collect()
        };
        Self {
            irradiance: self.irradiance.as_ref().map(values),
            direct_irradiance: self.direct_irradiance.as_ref().map(values),
            indirect_irradiance: self.indirect_irradiance.as_ref().map(values),
            radiosity: self.radiosity.as_ref().map(values),
            colours: views(&self.colours),
            colours_without_highlights: views(&self.colours_without_highlights),
            specular_radiance: self.specular_radiance.as_ref().map(|of| of.iter().map(values).collect()),
        }
    }
}

impl Engine {
    /// Derivatives of a loss at a solution, exact for the discretised model. `params` control the adjoint solve,
    /// whose residual is relative to the 2-norm of λ. The kinds requested must have been planned
    /// ([`crate::plan::PlanOptions::gradients`]).
    ///
    /// With the adjoint λ = λ₀ + (K - J)ᵀ μ of incident light and the cotangent μ = μ₀ + Uᵀ λ of outgoing light, dL =
    /// ⟨μ, d(E + K H)⟩ + ⟨λ, dU C⟩ + ⟨colours, dS C⟩.
    ///
    /// # Errors
    /// Fails if the solution belongs to another engine or to other materials, if derivatives of a requested
    /// kind were not planned, if a cotangent does not fit the scene or is not finite, if parameters are out
    /// of range, if the adjoint solve does not converge or a callback stops it, or if the backend fails.
    pub fn backward(
        &mut self,
        solution: &Solution,
        cotangent: &Cotangent,
        request: GradientRequest,
        params: &SolveParams,
    ) -> Result<Gradients, EngineError> {
        self.backward_with(solution, cotangent, request, params, &mut |_, _| ControlFlow::Continue(()))
    }

    /// Computes what [`Engine::backward`] does, and calls `progress` with the number of passes and the
    /// relative residual after each pass.
    ///
    /// # Errors
    /// Fails as [`Engine::backward`] does, and if `progress` stops the solve.
    #[doc(hidden)]
    pub fn backward_with(
        &mut self,
        solution: &Solution,
        cotangent: &Cotangent,
        request: GradientRequest,
        params: &SolveParams,
        progress: &mut SolveProgress,
    ) -> Result<Gradients, EngineError> {
        self.check_own(solution)?;
        self.check(cotangent, request)?;
        params.check()?;
        // The adjoint is linear: scaling keeps the device's numbers near 1 however steep the loss is.
        let steepness = cotangent.steepness();
        let cotangent = &cotangent.divided(steepness);
        let (irradiance, radiance, specular) = self.own_cotangents(cotangent);
        let views: Vec<(DVec3, Vec<[f64; 4]>)> = cotangent
            .views()
            .map(|(camera_position, colours)| (*camera_position, self.to_slots(colours)))
            .collect();
        let solver = self.plan().solver;
        let first_bounce = self.plan().has_first_bounce();
        let rounding = rounding(self.plan().settings.precision);
        let SolveParams { tolerance, max_passes, reduction } = *params;
        let mut operator = self.operators.adjoint()?;
        operator.set(&irradiance, &radiance, &specular)?;
        for (camera_position, colours) in &views {
            operator.add_view(*camera_position, colours)?;
        }
        // What is seen of glossy triangles does not contain what they reflect of lamps per bin.
        let seen = match first_bounce {
            true => Some(less(operator.given_specular()?, &specular)),
            false => None,
        };
        let (importance, info) = if request.light() {
            let solved = match solver {
                PlannedSolver::FixedPoint => {
                    let params = FixedPointParams { tolerance, max_passes, reduction };
                    fixed_point(&mut *operator, &params, progress)
                }
                PlannedSolver::Gmres { restart } => {
                    let params = GmresParams::new(tolerance, max_passes, restart);
                    gmres(&mut *operator, &params.rounding(rounding).reduction(reduction), progress)
                }
            };
            match solved {
                Ok(solved) => solved,
                // An adjoint that has not converged gives no usable gradient.
                Err(error) => return Err(error.map_best(|_, _| Ok::<_, EngineError>(None))?.into()),
            }
        } else {
            // Light does not depend on who looks.
            let info = SolveInfo { passes: 0, converged: true, residuals: Vec::new(), spectral_radius: None };
            (operator.vector()?, info)
        };
        let outgoing = operator.outgoing_cotangent(&importance)?;
        let lobes = if request.lobes() { operator.lobe_sums(&solution.state)? } else { None };
        let (facets, camera_positions) = match request.geometry() {
            true => {
                let movable = request.positions.then_some(&self.movable);
                operator.geometry(&solution.state, &importance, &views, movable)?
            }
            false => (Vec::new(), Vec::new()),
        };
        drop(operator);

        // Scale of what is also linear in the state's light.
        let of_light = steepness * self.unit;
        let per_metre = of_light * self.plan().placement.scale;
        let unscaled: Vec<DVec3> =
            self.scaled(1.0, &outgoing.radiance).into_iter().map(DVec3::from).collect();
        let of_radiance: Vec<DVec3> = unscaled.iter().map(|by| steepness * *by).collect();
        let of_lobes = match &seen {
            Some(seen) => less(outgoing.specular, seen),
            None => Vec::new(),
        };
        // ∂(δρ/π E): the same for δ, given ρ, and for ρ, given δ.
        let of_albedo: Vec<DVec3> =
            of_radiance.iter().zip(&solution.irradiance).map(|(&m, &h)| m * DVec3::from(h) / PI).collect();
        let materials = || of_albedo.iter().zip(&self.materials);
        let lobes = lobes.map(|sums| self.lobe_gradients(&sums, of_light));
        let direct = self.direct_gradients(cotangent, &unscaled, &of_lobes, request)?;
        let corners = request.positions.then(|| {
            let mut corners = self.corner_gradients(&facets, per_metre);
            let scale = steepness * self.plan().placement.scale;
            for ((to, by), facet) in corners.iter_mut().zip(&direct.facets).zip(self.plan().facets()) {
                to.iter_mut().zip(by.to_corners(facet)).for_each(|(to, by)| *to += by * scale);
            }
            self.keep_movable(&mut corners);
            corners
        });
        let emission = request.emission.then(|| {
            let mut emission = of_radiance.clone();
            for &i in self.direct.light.lamps().iter().flat_map(Lamp::triangles) {
                emission[i as usize] = steepness * direct.emission[i as usize];
            }
            emission
        });
        let mut lobes = lobes;
        if let Some(lobes) = &mut lobes {
            for (to, by) in lobes.iter_mut().zip(direct.specular.iter().zip(&direct.power)) {
                *to = (to.0 + steepness * *by.0, to.1 + steepness * by.1);
            }
        }
        Ok(Gradients {
            diffuse: request.diffuse.then(|| materials().map(|(&g, m)| g.dot(m.albedo.into())).collect()),
            albedo: request.albedo.then(|| materials().map(|(&g, m)| m.diffuse * g).collect()),
            specular: request.specular.then(|| match &lobes {
                Some(lobes) => lobes.iter().map(|(sigma, _)| *sigma).collect(),
                None => vec![DVec3::ZERO; of_radiance.len()],
            }),
            power: request.power.then(|| match &lobes {
                Some(lobes) => lobes.iter().map(|(_, power)| *power).collect(),
                None => vec![0.0; of_radiance.len()],
            }),
            emission,
            suns: request.emission.then(|| direct.suns.iter().map(|by| steepness * *by).collect()),
            vertices: corners.as_ref().map(|corners| self.vertex_gradients(corners)),
            corners,
            camera_positions: request.camera.then(|| {
                let scale = steepness * self.plan().placement.scale;
                let highlights = direct.cameras.iter().copied().chain(std::iter::repeat(DVec3::ZERO));
                let views = camera_positions.into_iter().zip(highlights);
                views.map(|(by_faces, by_highlights)| by_faces * per_metre + by_highlights * scale).collect()
            }),
            info,
        })
    }

    fn check(&self, cotangent: &Cotangent, request: GradientRequest) -> Result<(), EngineError> {
        let kinds = request.beyond(self.plan().options.gradients);
        if !kinds.is_empty() || !self.plan().options.gradients.any() {
            return Err(EngineError::NotPlanned { kinds });
        }
        let triangles = self.plan().facets.len();
        let check = |what: &'static str, values: &[DVec3]| {
            if values.len() != triangles {
                return Err(EngineError::CotangentLength { what, given: values.len(), triangles });
            }
            match values.iter().position(|v| !v.is_finite()) {
                Some(triangle) => Err(EngineError::CotangentNotFinite { what, triangle }),
                None => Ok(()),
            }
        };
        for (what, values) in [
            ("irradiance", &cotangent.irradiance),
            ("direct irradiance", &cotangent.direct_irradiance),
            ("indirect irradiance", &cotangent.indirect_irradiance),
        ] {
            values.as_ref().map_or(Ok(()), |values| check(what, values))?;
        }
        if let Some(values) = &cotangent.radiosity {
            check("radiosity", values)?;
        }
        if let Some(of) = &cotangent.specular_radiance {
            if of.len() != triangles {
                let (what, given) = ("specular radiance", of.len());
                return Err(EngineError::CotangentLength { what, given, triangles });
            }
            let bins = self.plan().bins.count();
            let wrong = of.iter().position(|values| !(values.is_empty() || values.len() == bins));
            if let Some(triangle) = wrong {
                return Err(EngineError::CotangentBins { triangle, given: of[triangle].len(), bins });
            }
            let finite = |values: &Vec<DVec3>| values.iter().all(|v| v.is_finite());
            if let Some(triangle) = of.iter().position(|values| !finite(values)) {
                return Err(EngineError::CotangentNotFinite { what: "specular radiance", triangle });
            }
        }
        cotangent.views().try_for_each(|(camera_position, values)| {
            check_position(*camera_position)?;
            check("face colours", values)
        })
    }

    /// λ₀ and μ₀ without the views; the radiosity is B = π L + Σ_o c_o L(o).
    #[expect(clippy::type_complexity, reason = "three arrays as the operators take them, used once")]
    fn own_cotangents(&self, cotangent: &Cotangent) -> (Vec<[f64; 4]>, Vec<[f64; 4]>, Vec<Option<Vec<f64>>>) {
        let plan = self.plan();
        let none = || vec![[0.0; 4]; plan.layout.slots() as usize];
        let mut irradiance = none();
        for values in [&cotangent.irradiance, &cotangent.indirect_irradiance].into_iter().flatten() {
            for (to, values) in irradiance.iter_mut().zip(self.to_slots(values)) {
                (0..3).for_each(|channel| to[channel] += values[channel]);
            }
        }
        if cotangent.radiosity.is_none() && cotangent.specular_radiance.is_none() {
            return (irradiance, none(), vec![None; plan.layout.groups.len()]);
        }
        let radiosity = cotangent.radiosity.as_ref().map_or_else(none, |radiosity| self.to_slots(radiosity));
        let page = |group: &crate::plan::Group| {
            let slots = plan.layout.slots_of(&group.tiles);
            let of_slot = |slot: u32| {
                let whole = DVec3::from_slice(&radiosity[slot as usize]);
                let triangle = plan.layout.order[slot as usize];
                let per_bin = cotangent.specular_radiance.as_ref().filter(|_| triangle != PADDING);
                let of_bins = per_bin.map(|of| of[triangle as usize].clone()).unwrap_or_default();
                let of_bin = move |(bin, c): (usize, &f64)| {
                    (*c * whole + of_bins.get(bin).copied().unwrap_or_default()).to_array()
                };
                plan.bins.projected.iter().enumerate().flat_map(of_bin)
            };
            group.class.glossy.then(|| slots.flat_map(of_slot).collect())
        };
        let specular = plan.layout.groups.iter().map(page).collect();
        (irradiance, radiosity.iter().map(|v| v.map(|x| PI * x)).collect(), specular)
    }

    /// Values per triangle in the order of the slots.
    fn to_slots(&self, values: &[DVec3]) -> Vec<[f64; 4]> {
        let slot = |&i: &u32| match i {
            PADDING => [0.0; 4],
            i => values[i as usize].extend(0.0).to_array(),
        };
        self.plan().layout.order.iter().map(slot).collect()
    }

    /// Derivatives with respect to σ and p of every triangle: ∂/∂σ = N S and ∂/∂p = ⟨σ, N' S + N S_ln⟩.
    fn lobe_gradients(&self, sums: &[LobeSums], scale: f64) -> Vec<(DVec3, f64)> {
        let mut gradients = vec![(DVec3::ZERO, 0.0); self.materials.len()];
        for (&i, [sum, logarithms]) in self.plan().layout.order.iter().zip(sums) {
            if i == PADDING {
                continue;
            }
            let material = &self.materials[i as usize];
            let (n, slope) =
                (material.specular_normalization(), material.specular_normalization_derivative());
            let power = DVec3::from(material.specular).dot(slope * *sum + n * *logarithms);
            gradients[i as usize] = (scale * n * *sum, scale * power);
        }
        gradients
    }

    fn corner_gradients(&self, facets: &[FacetGradient], per_metre: f64) -> Vec<[DVec3; 3]> {
        let plan = self.plan();
        let mut corners = vec![[DVec3::ZERO; 3]; plan.facets.len()];
        for (&i, gradient) in plan.layout.order.iter().zip(facets) {
            if i != PADDING {
                corners[i as usize] = gradient.to_corners(&plan.facets[i as usize]).map(|c| c * per_metre);
            }
        }
        corners
    }

    /// Derivatives by corners that are not movable are zero.
    #[doc(hidden)]
    pub fn keep_movable(&self, corners: &mut [[DVec3; 3]]) {
        for (triangle, corners) in self.triangles.iter().zip(corners) {
            for (&vertex, corner) in triangle.iter().zip(corners) {
                *corner = if self.movable.vertex(vertex) { *corner } else { DVec3::ZERO };
            }
        }
    }

    fn vertex_gradients(&self, corners: &[[DVec3; 3]]) -> Vec<DVec3> {
        let mut vertices = vec![DVec3::ZERO; self.vertices];
        for (triangle, gradients) in self.triangles.iter().zip(corners) {
            for (&vertex, &gradient) in triangle.iter().zip(gradients) {
                vertices[vertex as usize] += gradient;
            }
        }
        vertices
    }
}

/// The differences of values per group.
fn less(values: Vec<Option<Vec<f64>>>, others: &[Option<Vec<f64>>]) -> Vec<Option<Vec<f64>>> {
    let page = |(values, others): (Option<Vec<f64>>, &Option<Vec<f64>>)| {
        let mut values = values?;
        values.iter_mut().zip(others.iter().flatten()).for_each(|(to, other)| *to -= other);
        Some(values)
    };
    values.into_iter().zip(others).map(page).collect()
}

impl Gradients {
    /// Sums over the triangles of each material.
    pub fn by_material(&self, scene: &Scene) -> Vec<MaterialGradients> {
        self.sums(scene.materials.len(), |i| Some(scene.triangles[i].material as usize))
    }

    /// Sums over the triangles of each mesh.
    pub fn by_mesh(&self, scene: &Scene) -> Vec<MaterialGradients> {
        let mut mesh_of = vec![None; scene.triangles.len()];
        for (m, mesh) in scene.meshes.iter().enumerate() {
            mesh_of[mesh.range.start as usize..mesh.range.end as usize].fill(Some(m));
        }
        self.sums(scene.meshes.len(), |i| mesh_of[i])
    }

    fn sums(&self, count: usize, of: impl Fn(usize) -> Option<usize>) -> Vec<MaterialGradients> {
        let mut sums = vec![MaterialGradients::default(); count];
        fn add<T: Copy + std::ops::AddAssign>(
            values: &Option<Vec<T>>,
            sums: &mut [MaterialGradients],
            of: &impl Fn(usize) -> Option<usize>,
            field: impl Fn(&mut MaterialGradients) -> &mut T,
        ) {
            for (i, value) in values.iter().flatten().enumerate() {
                if let Some(at) = of(i) {
                    *field(&mut sums[at]) += *value;
                }
            }
        }
        add(&self.emission, &mut sums, &of, |s| &mut s.emission);
        add(&self.diffuse, &mut sums, &of, |s| &mut s.diffuse);
        add(&self.albedo, &mut sums, &of, |s| &mut s.albedo);
        add(&self.specular, &mut sums, &of, |s| &mut s.specular);
        add(&self.power, &mut sums, &of, |s| &mut s.power);
        sums
    }
}

/// Derivatives with respect to parameters that several triangles share; zero for kinds not requested.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MaterialGradients {
    /// With respect to L_e, RGB, per W/(m² sr).
    pub emission: DVec3,
    /// With respect to the diffuse constant δ.
    pub diffuse: f64,
    /// With respect to the albedo ρ, RGB.
    pub albedo: DVec3,
    /// With respect to the specular constant σ, RGB.
    pub specular: DVec3,
    /// With respect to the power p.
    pub power: f64,
}
