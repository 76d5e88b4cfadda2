//! The transposed operators combined for the solvers: λ = λ₀ + (K - J)ᵀ (μ₀ + Uᵀ λ), with λ the adjoint of incident
//! light (importance) and μ the cotangent of outgoing light. A state of the adjoint holds the cotangents of
//! irradiance and, per bin, of H(b).

use super::clusters::Sources;
use super::clusters_adjoint::ClusterCotangents;
use super::completion::Values;
use super::exchange_adjoint::ExchangeAdjoint;
use super::exchange_derivative::ExchangeDerivative;
use super::observation_adjoint::ObservationAdjoint;
use super::reflection_adjoint::ReflectionAdjoint;
use super::scene_buffers::list;
use super::state::{State, StateBuffers, page, page_of, pages};
use super::watch::TransportError;
use super::{Context, Operators, real};
use crate::gpu::{Buffer, BufferKind, Device, GpuError};
use crate::model::{Clusters, FacetGradient};
use crate::plan::{PairLists, Plan};
use crate::scene::Movable;
use crate::solve::LightOperator;
use glam::DVec3;

/// The cotangents that the loss itself provides, and the sums of gradients.
pub struct AdjointBuffers {
    /// λ₀: of irradiance, vec4 per slot.
    pub irradiance: Buffer,
    /// μ₀: of radiance, vec4 per slot.
    pub radiance: Buffer,
    /// μ₀: of specular radiance, per glossy group.
    pub specular: Vec<Option<Buffer>>,
    /// The cotangent of irradiance that a pass reads, vec4 per slot, as point-to-point kernels bind it of partners:
    /// unlike that of a state, it extends past the last slot.
    pub receivers: Buffer,
    /// [`crate::plan::FarRuns`] by source; with clusters [`crate::model::ReceiverLists`].
    pub far_runs: Buffer,
    /// Where clusters stand for far triangles.
    pub clusters: Option<ClusterCotangents>,
    pub near_offsets: Buffer,
    pub near_receivers: Buffer,
    /// `FacetGradient` of glsl/facet_gradient.glsl, per slot.
    gradients: Option<Buffer>,
    /// Two vec4 per slot: glsl/reflect_glossy_derivative.comp.
    lobe_sums: Option<Buffer>,
}

/// What a backward pass needs in addition to the operators.
pub struct AdjointKernels {
    pub(super) buffers: AdjointBuffers,
    exchange: ExchangeAdjoint,
    reflection: ReflectionAdjoint,
    observation: ObservationAdjoint,
    derivative: Option<ExchangeDerivative>,
}

/// Derivatives of a loss by the specular parameters of a slot: Σ_ob μ(o) lobe H(b), and the same with the factor
/// ln⟨h,n⟩.
pub type LobeSums = [DVec3; 2];

impl AdjointKernels {
    /// The kernels and buffers that the plan counts; `None` without planned gradients.
    pub fn new(device: &Device, plan: &Plan) -> Result<Option<Self>, GpuError> {
        let Some(PairLists { far, near }) = &plan.interactions().by_source else { return Ok(None) };
        let request = plan.options.gradients;
        let rgb = u64::from(plan.layout.slots()) * plan.rgb_bytes();
        let sources = u64::from(plan.sources()) * plan.rgb_bytes();
        let storage = |label: &str, bytes: u64| Buffer::new(device, label, bytes, BufferKind::Storage);
        let lobes = request.lobes() && plan.classes.iter().any(|class| class.glossy);
        let geometry = request.geometry();
        let buffers = AdjointBuffers {
            irradiance: storage("cotangent: irradiance", rgb)?,
            radiance: storage("cotangent: radiance", rgb)?,
            specular: pages(device, plan, "cotangent: specular", |group| group.class.glossy)?,
            receivers: storage(
                "cotangent: receivers",
                rgb + u64::from(plan.partner_slots()) * plan.rgb_bytes(),
            )?,
            far_runs: match plan.clusters().and_then(Clusters::receivers) {
                None => list(device, plan, "far runs, by source", far.words())?,
                Some(lists) => list(device, plan, "cluster receivers", lists.words())?,
            },
            clusters: ClusterCotangents::new(device, plan)?,
            near_offsets: list(device, plan, "near offsets, by source", &near.offsets)?,
            near_receivers: list(device, plan, "near receivers", &near.partners)?,
            gradients: geometry.then(|| storage("facet gradients", 4 * sources)).transpose()?,
            lobe_sums: lobes.then(|| storage("lobe sums", 2 * rgb)).transpose()?,
        };
        Ok(Some(Self {
            buffers,
            exchange: ExchangeAdjoint::new(device, plan)?,
            reflection: ReflectionAdjoint::new(device, plan)?,
            observation: ObservationAdjoint::new(device, plan)?,
            derivative: geometry.then(|| ExchangeDerivative::new(device, plan)).transpose()?,
        }))
    }
}

impl AdjointBuffers {
    /// Sets the cotangents of the loss: λ₀ of irradiance and μ₀ of radiance, per slot, and μ₀ of specular radiance
    /// per group, laid out like the bins of a state.
    fn set(
        &self,
        context: &Context,
        irradiance: &[[f64; 4]],
        radiance: &[[f64; 4]],
        specular: &[Option<Vec<f64>>],
    ) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let precision = plan.settings.precision;
        real::upload(device, &self.irradiance, precision, irradiance.as_flattened())?;
        real::upload(device, &self.radiance, precision, radiance.as_flattened())?;
        for (g, group) in plan.glossy_groups() {
            let page = page(&self.specular, g)?;
            match specular.get(g).and_then(Option::as_ref) {
                Some(values) => real::upload(device, page, precision, values)?,
                None => {
                    let mut batch = device.batch()?;
                    batch.fill(page, 0, plan.page_bytes(group), 0)?;
                    batch.submit()?;
                }
            }
        }
        Ok(())
    }

    /// Copies the cotangent of irradiance to where point-to-point kernels read it of partners.
    pub fn copy_receivers(&self, context: &Context, cotangent: &StateBuffers) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let mut batch = device.batch()?;
        batch.copy(&cotangent.irradiance, 0, &self.receivers, 0, plan.irradiance_bytes())?;
        batch.submit()?;
        Ok(())
    }

    /// Initialises the cotangent of outgoing light to μ₀, or to zero.
    fn start(&self, context: &Context, given: bool) -> Result<(), TransportError> {
        let Context { device, plan, outgoing, .. } = context;
        let rgb = u64::from(plan.layout.slots()) * plan.rgb_bytes();
        let mut copies = vec![(&self.radiance, &outgoing.radiance, rgb)];
        for (g, group) in plan.glossy_groups() {
            copies.push((page(&self.specular, g)?, page(&outgoing.specular, g)?, plan.page_bytes(group)));
        }
        let mut batch = device.batch()?;
        for (from, to, bytes) in copies {
            match given {
                true => batch.copy(from, 0, to, 0, bytes)?,
                false => batch.fill(to, 0, bytes, 0)?,
            }
        }
        batch.submit()?;
        Ok(())
    }
}

/// The adjoint of the light equation, for the solvers.
pub struct AdjointOperator<'a> {
    operators: &'a mut Operators,
    adjoint: &'a mut AdjointKernels,
}

impl<'a> AdjointOperator<'a> {
    /// Borrows both for one solve. Call [`Self::set`] first.
    pub fn new(operators: &'a mut Operators, adjoint: &'a mut AdjointKernels) -> Self {
        Self { operators, adjoint }
    }

    fn context(&self) -> &Context {
        &self.operators.context
    }

    /// Sets the cotangents of the loss: λ₀ of irradiance and μ₀ of radiance, per slot, and μ₀ of specular radiance
    /// per group, laid out like [`Operators::bins`].
    pub fn set(
        &mut self,
        irradiance: &[[f64; 4]],
        radiance: &[[f64; 4]],
        specular: &[Option<Vec<f64>>],
    ) -> Result<(), TransportError> {
        self.adjoint.buffers.set(self.context(), irradiance, radiance, specular)
    }

    /// Adds the cotangent of the radiance of every slot towards `camera_position` (metres).
    pub fn add_view(&mut self, camera_position: DVec3, colours: &[[f64; 4]]) -> Result<(), TransportError> {
        let face_colours = self.operators.observation.colours();
        let AdjointKernels { observation, buffers, .. } = &*self.adjoint;
        observation.run(self.context(), buffers, face_colours, camera_position, colours)
    }

    /// μ₀ of specular radiance per glossy group: that of the loss, and of the views added to it.
    pub fn given_specular(&self) -> Result<Vec<Option<Vec<f64>>>, TransportError> {
        let specular = &self.adjoint.buffers.specular;
        let pages = (0..specular.len()).map(|group| self.operators.page(specular, group));
        Ok(pages.collect::<Result<_, _>>()?)
    }

    /// μ = μ₀ + Uᵀ λ, the cotangent of outgoing light: of radiance per slot, and of specular radiance per group. It
    /// stays on the device until the next use of the operators.
    pub fn outgoing_cotangent(&mut self, cotangent: &State) -> Result<super::OutgoingValues, TransportError> {
        // The bins of antiradiance go to a state that is discarded.
        let mut unused = self.vector()?;
        self.transpose(Some(cotangent), true, &mut unused)?;
        Ok(self.operators.outgoing_values()?)
    }

    /// Derivatives by the specular parameters of each slot; requires [`Self::outgoing_cotangent`]. `None` where
    /// nothing is glossy.
    pub fn lobe_sums(&mut self, x: &State) -> Result<Option<Vec<LobeSums>>, TransportError> {
        let Some(sums) = &self.adjoint.buffers.lobe_sums else { return Ok(None) };
        let context = self.context();
        self.adjoint.reflection.derivative(context, x, sums)?;
        let Context { device, plan, .. } = context;
        let count = u64::from(plan.layout.slots()) * 8;
        let values = real::download(device, sums, plan.settings.precision, count)?;
        let rgb = |v: &[f64]| DVec3::new(v[0], v[1], v[2]);
        Ok(Some(values.chunks_exact(8).map(|v| [rgb(v), rgb(&v[4..])]).collect()))
    }

    /// Per slot, the derivative of ⟨λ, U (E + (K - J) x)⟩ and of the views' ⟨colours, S (E + K x)⟩ with respect to geometry,
    /// and of the latter with respect to each camera; per unit of length of the engine. Recomputes the outgoing
    /// light. The former are those of the transport, too,
    /// of `movable` triangles at least, where these are stated.
    pub fn geometry(
        &mut self,
        x: &State,
        cotangent: &State,
        views: &[(DVec3, Vec<[f64; 4]>)],
        movable: Option<&Movable>,
    ) -> Result<(Vec<FacetGradient>, Vec<DVec3>), TransportError> {
        self.operators.update_outgoing(Some(x), true, true)?;
        let Operators { context, exchange: forward, monitor, .. } = &mut *self.operators;
        let AdjointKernels { buffers, exchange, derivative, observation: views_derivative, .. } =
            &mut *self.adjoint;
        let (Some(gradients), Some(derivative)) = (&buffers.gradients, derivative) else {
            return Err(TransportError::missing("derivatives with respect to geometry"));
        };
        let count = u64::from(context.plan.sources()) * 16;
        let precision = context.plan.settings.precision;
        let mut batch = context.device.batch()?;
        batch.fill(gradients, 0, count * precision.bytes(), 0)?;
        batch.submit()?;
        if let Some(movable) = movable {
            derivative.run(context, buffers, [x, cotangent], gradients, movable, monitor)?;
            if let (Some(cotangents), Some(light)) = (&buffers.clusters, &forward.clusters) {
                let (x, cotangent) = (x.resident()?, cotangent.resident()?);
                for (g, group) in context.plan.layout.groups.iter().enumerate() {
                    let none = &context.scene.no_bins;
                    let triangles = Sources {
                        class: group.class,
                        indices: context.plan.layout.slots_of(&group.tiles),
                        antiradiance: page_of(&x.bins, g, group.class.has_bins(), none)?,
                        specular: page_of(&context.outgoing.specular, g, group.class.glossy, none)?,
                    };
                    let of_clusters = light.gather(context, g, &triangles, true)?;
                    let sources = [&triangles, &of_clusters];
                    derivative.listed(context, buffers, (g, sources), cotangent, gradients, monitor)?;
                    exchange.clusters(context, buffers, g, cotangent, monitor)?;
                    cotangents.shares(context, g, sources, gradients)?;
                }
            }
            let bytes = 16 * precision.bytes();
            context.complete_slots(gradients, bytes)?;
            let runs = context.plan.clusters().map_or(0, |clusters| clusters.runs().len());
            for run in 0..runs {
                let values = Values { offset: 0, first: 0, bytes };
                context.complete(gradients, values, context.plan.clusters_by_rank(run))?;
            }
        }
        if context.plan.has_first_bounce() && !views.is_empty() {
            self.operators.update_outgoing(Some(x), true, false)?;
        }
        let Operators { context, observation, .. } = &mut *self.operators;
        let mut camera_positions = Vec::with_capacity(views.len());
        for (camera_position, colours) in views {
            let face_colours = observation.colours();
            camera_positions.push(views_derivative.derivative(
                context,
                face_colours,
                gradients,
                *camera_position,
                colours,
            )?);
        }
        let values = real::download(&context.device, gradients, precision, count)?;
        let gradient = |v: &[f64]| {
            let vector = |at: usize| DVec3::new(v[at], v[at + 1], v[at + 2]);
            FacetGradient {
                corners: [vector(0), vector(4), vector(8)],
                normal: vector(12),
                area: v[3],
                characteristic_area: v[7],
            }
        };
        let mut gradients: Vec<FacetGradient> = values.chunks_exact(16).map(gradient).collect();
        if let Some(clusters) = context.plan.clusters() {
            let shares: Vec<f64> = values.chunks_exact(16).map(|v| v[11]).collect();
            clusters.pull_to_triangles(&context.plan.facets, &mut gradients, &shares);
            gradients.truncate(context.plan.layout.order.len());
        }
        Ok((gradients, camera_positions))
    }

    /// y = [given] λ₀ + (K - J)ᵀ ([given] μ₀ + Uᵀ x); also stores the cotangent of outgoing light.
    fn transpose(&mut self, x: Option<&State>, given: bool, y: &mut State) -> Result<(), TransportError> {
        let Operators { context, vectors, monitor, .. } = &mut *self.operators;
        let AdjointKernels { buffers, exchange, reflection, .. } = &mut *self.adjoint;
        vectors.clear(context, y)?;
        buffers.start(context, given)?;
        if let Some(x) = x {
            exchange.run(context, buffers, x, y, monitor)?;
        }
        reflection.run(context, buffers, given, y)?;
        Ok(())
    }
}

impl LightOperator for AdjointOperator<'_> {
    type Vector = State;
    type Error = TransportError;

    fn vector(&mut self) -> Result<State, TransportError> {
        self.operators.vector()
    }

    fn pass(&mut self, x: Option<&State>, emission: bool, y: &mut State) -> Result<(), TransportError> {
        self.transpose(x, emission, y)
    }

    fn dot(&mut self, x: &State, y: &State) -> Result<f64, TransportError> {
        self.operators.dot(x, y)
    }

    fn combine(&mut self, a: f64, x: &State, b: f64, y: &mut State) -> Result<(), TransportError> {
        self.operators.combine(a, x, b, y)
    }

    fn combine_dot(
        &mut self,
        a: f64,
        x: &State,
        b: f64,
        y: &mut State,
        z: Option<&State>,
    ) -> Result<f64, TransportError> {
        self.operators.combine_dot(a, x, b, y, z)
    }

    fn scale(&mut self, b: f64, y: &mut State) -> Result<(), TransportError> {
        self.operators.scale(b, y)
    }

    /// All entries count: which of them matter depends on the loss.
    fn judged(&mut self, _: &State) -> Result<Option<Vec<f64>>, TransportError> {
        Ok(None)
    }
}
