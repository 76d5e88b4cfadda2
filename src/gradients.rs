//! Derivatives of a loss, by the adjoint of the light equation.

use crate::engine::{Engine, EngineError, Solution, SolveParams, check_position, power_of_two};
use crate::model::FacetGradient;
use crate::options::setters;
use crate::plan::{GradientRequest, PADDING, PlannedSolver};
use crate::scene::{Material, Scene};
use crate::solve::{FixedPointParams, GmresParams, SolveInfo, SolveProgress, fixed_point, gmres};
use crate::transport::{AdjointOperator, LobeSums};
use glam::DVec3;
use std::f64::consts::PI;
use std::ops::ControlFlow;

/// Derivatives of a loss with respect to the results of a solve: RGB, per triangle of the scene. A loss may depend on
/// several of them; `None` stands for zeros.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct Cotangent {
    /// Of [`Solution::irradiance`], per W/m².
    pub irradiance: Option<Vec<DVec3>>,
    /// Of [`Solution::radiosity`], per W/m².
    pub radiosity: Option<Vec<DVec3>>,
    /// Of [`Engine::face_colours`] for cameras (metres), per W/(m² sr).
    pub colours: Vec<(DVec3, Vec<DVec3>)>,
}

setters!(Cotangent {
    irradiance: Option<Vec<DVec3>>,
    radiosity: Option<Vec<DVec3>>,
    colours: Vec<(DVec3, Vec<DVec3>)>,
});

/// Derivatives of a loss with respect to the parameters of a scene; `None` for those not requested.
#[derive(Clone, Debug)]
pub struct Gradients {
    /// With respect to L_e, RGB, per triangle. Triangles without area have zero everywhere.
    pub emission: Option<Vec<DVec3>>,
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
    /// With respect to each camera of [`Cotangent::colours`], per metre.
    pub camera_positions: Option<Vec<DVec3>>,
    /// How the adjoint solve went.
    pub info: SolveInfo,
}

impl Cotangent {
    fn values(&self) -> impl Iterator<Item = &Vec<DVec3>> {
        self.irradiance.iter().chain(&self.radiosity).chain(self.colours.iter().map(|(_, values)| values))
    }

    /// The power of two at or below the largest entry.
    fn steepness(&self) -> f64 {
        power_of_two(self.values().flatten().map(|v| v.abs().max_element()).fold(0.0, f64::max))
    }

    fn divided(&self, by: f64) -> Self {
        let values = |values: &Vec<DVec3>| values.iter().map(|&v| v / by).collect();
        Self {
            irradiance: self.irradiance.as_ref().map(values),
            radiosity: self.radiosity.as_ref().map(values),
            colours: self
                .colours
                .iter()
                .map(|(camera_position, colours)| (*camera_position, values(colours)))
                .collect(),
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
    pub fn backward(
        &mut self,
        solution: &Solution,
        cotangent: &Cotangent,
        request: GradientRequest,
        params: &SolveParams,
    ) -> Result<Gradients, EngineError> {
        self.backward_with(solution, cotangent, request, params, &mut |_, _| ControlFlow::Continue(()))
    }

    /// As [`Engine::backward`]; calls `progress` with the number of passes and the relative residual after each pass.
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
            .colours
            .iter()
            .map(|(camera_position, colours)| (*camera_position, self.to_slots(colours)))
            .collect();
        let solver = self.plan().solver;
        let SolveParams { tolerance, max_passes } = *params;
        let Some(adjoint) = &mut self.adjoint else {
            return Err(EngineError::NotPlanned { kinds: Vec::new() });
        };
        let mut operator = AdjointOperator::new(&mut self.operators, adjoint);
        operator.set(&irradiance, &radiance, &specular)?;
        for (camera_position, colours) in &views {
            operator.add_view(*camera_position, colours)?;
        }
        let solved = match solver {
            PlannedSolver::FixedPoint => {
                fixed_point(&mut operator, &FixedPointParams { tolerance, max_passes }, progress)
            }
            PlannedSolver::Gmres { restart } => {
                gmres(&mut operator, &GmresParams { tolerance, max_passes, restart }, progress)
            }
        };
        let (importance, info) = match solved {
            Ok(solved) => solved,
            // An adjoint that has not converged gives no usable gradient.
            Err(error) => return Err(error.map_best(|_, _| Ok::<_, EngineError>(None))?.into()),
        };
        let outgoing = operator.outgoing_cotangent(&importance)?;
        let lobes = if request.lobes() { operator.lobe_sums(&solution.state)? } else { None };
        let (facets, camera_positions) = match request.geometry() {
            true => operator.geometry(&solution.state, &importance, &views, request.positions)?,
            false => (Vec::new(), Vec::new()),
        };

        // Scale of what is also linear in the state's light.
        let of_light = steepness * self.unit;
        let per_metre = of_light * self.plan().placement.scale;
        let of_radiance: Vec<DVec3> =
            self.scaled(steepness, &outgoing.radiance).into_iter().map(DVec3::from).collect();
        // ∂(δρ/π E): the same for δ, given ρ, and for ρ, given δ.
        let of_albedo: Vec<DVec3> =
            of_radiance.iter().zip(&solution.irradiance).map(|(&m, &h)| m * DVec3::from(h) / PI).collect();
        let of_direct = self.direct_cotangent(cotangent, steepness, &of_radiance);
        let materials = || of_albedo.iter().zip(&self.materials);
        let lobes = lobes.map(|sums| self.lobe_gradients(&sums, of_light));
        let corners = request.positions.then(|| {
            let mut corners = self.corner_gradients(&facets, per_metre);
            self.add_direct_corners(&of_direct, &mut corners);
            corners
        });
        let emission = request.emission.then(|| {
            let mut emission = of_radiance.clone();
            self.set_lamp_emission(cotangent, steepness, &of_direct, &mut emission);
            emission
        });
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
            vertices: corners.as_ref().map(|corners| self.vertex_gradients(corners)),
            corners,
            camera_positions: request.camera.then(|| {
                camera_positions.into_iter().map(|camera_position| camera_position * per_metre).collect()
            }),
            info,
        })
    }

    fn check(&self, cotangent: &Cotangent, request: GradientRequest) -> Result<(), EngineError> {
        let kinds = request.beyond(self.plan().options.gradients);
        if !kinds.is_empty() || self.adjoint.is_none() {
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
        if let Some(values) = &cotangent.irradiance {
            check("irradiance", values)?;
        }
        if let Some(values) = &cotangent.radiosity {
            check("radiosity", values)?;
        }
        cotangent.colours.iter().try_for_each(|(camera_position, values)| {
            check_position(*camera_position)?;
            check("face colours", values)
        })
    }

    /// λ₀ and μ₀ without the views; the radiosity is B = π L + Σ_o c_o L(o).
    #[expect(clippy::type_complexity, reason = "three arrays as the operators take them, used once")]
    fn own_cotangents(&self, cotangent: &Cotangent) -> (Vec<[f64; 4]>, Vec<[f64; 4]>, Vec<Option<Vec<f64>>>) {
        let plan = self.plan();
        let none = || vec![[0.0; 4]; plan.layout.slots() as usize];
        let irradiance = cotangent.irradiance.as_ref().map_or_else(none, |values| self.to_slots(values));
        let Some(radiosity) = &cotangent.radiosity else {
            return (irradiance, none(), vec![None; plan.layout.groups.len()]);
        };
        let radiosity = self.to_slots(radiosity);
        let page = |group: &crate::plan::Group| {
            let slots = plan.layout.slots_of(&group.tiles);
            let of_slot = |slot: u32| {
                let [r, g, b, _] = radiosity[slot as usize];
                plan.bins.projected.iter().flat_map(move |c| [c * r, c * g, c * b])
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

    /// Cotangent of the direct irradiance of each triangle: that of irradiance, and through its diffuse reflection.
    fn direct_cotangent(&self, cotangent: &Cotangent, steepness: f64, of_radiance: &[DVec3]) -> Vec<DVec3> {
        let reflected = |(m, material): (&DVec3, &Material)| *m * DVec3::from(material.diffuse_albedo()) / PI;
        let mut of_direct: Vec<DVec3> = of_radiance.iter().zip(&self.materials).map(reflected).collect();
        for (to, own) in of_direct.iter_mut().zip(cotangent.irradiance.iter().flatten()) {
            *to += steepness * *own;
        }
        of_direct
    }

    /// Derivatives by the emission of lamps: by what is seen of them, and by their direct light. The triangles of one lamp share the latter by
    /// area.
    fn set_lamp_emission(
        &self,
        cotangent: &Cotangent,
        steepness: f64,
        of_direct: &[DVec3],
        emission: &mut [DVec3],
    ) {
        let facets = self.plan().facets();
        for (l, lamp) in self.direct.lamps().iter().enumerate() {
            let of_light: DVec3 =
                of_direct.iter().enumerate().map(|(i, &d)| d * self.direct.factors(i)[l]).sum();
            let area: f64 = lamp.triangles.iter().map(|&i| facets[i as usize].area).sum();
            for i in lamp.triangles.iter().map(|&i| i as usize) {
                let radiosity = cotangent.radiosity.as_ref().map_or(DVec3::ZERO, |values| PI * values[i]);
                emission[i] = steepness * radiosity + of_light * (facets[i].area / area);
            }
        }
        for (camera_position, colours) in &cotangent.colours {
            for i in self.lamp_triangles_facing(*camera_position) {
                emission[i] += steepness * colours[i];
            }
        }
    }

    /// Adds the derivatives of direct light by the corners of receivers, blockers and lamps.
    fn add_direct_corners(&self, of_direct: &[DVec3], corners: &mut [[DVec3; 3]]) {
        let (plan, lamps) = (self.plan(), self.direct.lamps());
        let radiance: Vec<DVec3> =
            lamps.iter().map(|lamp| self.materials[lamp.first()].emission.into()).collect();
        let by_factor = |receiver: usize, lamp: usize| of_direct[receiver].dot(radiance[lamp]);
        let facets = self.direct.pull_back(plan.facets(), by_factor);
        for ((to, gradient), facet) in corners.iter_mut().zip(&facets).zip(plan.facets()) {
            for (to, by) in to.iter_mut().zip(gradient.to_corners(facet)) {
                *to += by * plan.placement.scale;
            }
        }
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
