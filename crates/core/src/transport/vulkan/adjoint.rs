//! The transposed operators combined for the solvers: λ = λ₀ + (K - J)ᵀ (μ₀ + Uᵀ λ), with λ the adjoint of incident
//! light (importance) and μ the cotangent of outgoing light. A state of the adjoint holds the cotangents of
//! irradiance and, per bin, of H(b).

use super::bundle::PassMonitor;
use super::exchange_adjoint::ExchangeAdjoint;
use super::exchange_derivative::ExchangeDerivative;
use super::observation_adjoint::ObservationAdjoint;
use super::reflection::Reflection;
use super::reflection_adjoint::ReflectionAdjoint;
use super::residency::{Part, View};
use super::scene_buffers::filled;
use super::specular::{Accumulated, Specular, SpecularCotangents};
use super::state::{State, page_of};
use super::{Context, Forward, all, of, real};
use crate::model::FacetGradient;
use crate::plan::{PairLists, Piece, Plan};
use crate::solve::{LightOperator, Orthonormalised};
use crate::transport::TransportError;
use crate::transport::{self, Adjoint, LobeSums, OutgoingValues};
use antirad_gpu::{Buffer, BufferKind, BufferSlice, Device, GpuError};
use antirad_scene::Movable;
use glam::DVec3;

/// The cotangents that the loss itself provides, and the sums of gradients.
pub struct AdjointBuffers {
    /// λ₀: cotangent of irradiance, vec4 per slot.
    pub irradiance: Buffer,
    /// μ₀: cotangent of diffuse radiance, vec4 per slot.
    pub radiance: Buffer,
    /// μ₀ and μ: cotangents of specular radiance.
    pub specular: SpecularCotangents,
    /// The cotangent of irradiance that a pass reads, vec4 per slot, as point-to-point kernels bind it of partners:
    /// unlike that of a state, it extends past the last slot.
    pub receivers: Buffer,
    /// [`crate::plan::FarRuns`] by source.
    pub far_runs: Buffer,
    pub near_offsets: Buffer,
    pub near_receivers: Buffer,
    /// `FacetGradient` of crates/core/glsl/facet_gradient.glsl, per slot.
    gradients: Option<Buffer>,
    /// Two vec4 per slot: crates/core/glsl/reflect_glossy_derivative.comp.
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

impl AdjointKernels {
    /// The kernels and buffers that the plan counts; `None` without planned gradients.
    ///
    /// # Errors
    /// Fails if the device cannot compile a kernel, or has no memory for a buffer.
    pub fn new(device: &Device, plan: &Plan) -> Result<Option<Self>, GpuError> {
        let Some(PairLists { far, near }) = &plan.interactions().by_source else { return Ok(None) };
        let request = plan.options.gradients;
        let rgb = u64::from(plan.layout.slots()) * plan.rgb_bytes();
        let storage = |label: &str, bytes: u64| Buffer::new(device, label, bytes, BufferKind::Storage);
        let lobes = request.lobes() && plan.classes.iter().any(|class| class.glossy);
        let geometry = request.geometry();
        let buffers = AdjointBuffers {
            irradiance: storage("cotangent: irradiance", rgb)?,
            radiance: storage("cotangent: radiance", rgb)?,
            specular: SpecularCotangents::new(device, plan)?,
            receivers: storage(
                "cotangent: receivers",
                rgb + u64::from(plan.partner_slots()) * plan.rgb_bytes(),
            )?,
            far_runs: filled(device, "far runs, by source", far.words())?,
            near_offsets: filled(device, "near offsets, by source", &near.offsets)?,
            near_receivers: filled(device, "near receivers", &near.partners)?,
            gradients: geometry.then(|| storage("facet gradients", 4 * rgb)).transpose()?,
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
        plan.glossy_groups()
            .try_for_each(|(g, _)| self.specular.set(context, g, specular.get(g).and_then(Option::as_deref)))
    }

    /// Copies the cotangent of irradiance to where point-to-point kernels read it of partners.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn copy_receivers(&self, context: &Context, cotangent: &State) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let irradiance = cotangent.show(device, &Part::irradiance(plan))?;
        let mut batch = device.batch()?;
        batch.copy(irradiance.buffer(), 0, &self.receivers, 0, plan.irradiance_bytes())?;
        batch.defer()?;
        Ok(())
    }

    /// Initialises the cotangent of diffuse radiance to μ₀, or to zero.
    fn start(&self, context: &Context, given: bool) -> Result<(), TransportError> {
        let Context { device, plan, outgoing, .. } = context;
        let bytes = u64::from(plan.layout.slots()) * plan.rgb_bytes();
        let mut batch = device.batch()?;
        match given {
            true => batch.copy(&self.radiance, 0, &outgoing.radiance, 0, bytes)?,
            false => batch.fill(&outgoing.radiance, 0, bytes, 0)?,
        }
        batch.defer()?;
        Ok(())
    }
}

/// The adjoint of the light equation, for the solvers.
pub struct AdjointOperator<'a> {
    operators: &'a mut Forward,
    adjoint: &'a mut AdjointKernels,
}

impl<'a> AdjointOperator<'a> {
    /// Borrows both for one solve.
    pub fn new(operators: &'a mut Forward, adjoint: &'a mut AdjointKernels) -> Self {
        Self { operators, adjoint }
    }

    fn context(&self) -> &Context {
        &self.operators.context
    }

    fn specular_cotangent(&self, which: Specular) -> Result<Vec<Option<Vec<f64>>>, TransportError> {
        let context = self.context();
        let groups = 0..context.plan.layout.groups.len();
        groups.map(|g| self.adjoint.buffers.specular.download(context, which, g)).collect()
    }

    /// y = [given] λ₀ + (K - J)ᵀ ([given] μ₀ + Uᵀ x); also stores the cotangent of outgoing light, of specular radiance that of the
    /// triangles of this rank.
    fn transpose(&mut self, x: Option<&State>, given: bool, y: &State) -> Result<(), TransportError> {
        let Forward { context, monitor, .. } = &mut *self.operators;
        let AdjointKernels { buffers, exchange, reflection, .. } = &mut *self.adjoint;
        buffers.start(context, given)?;
        if let Some(x) = x {
            exchange.begin(context, buffers, x, monitor)?;
        }
        for groups in context.plan.sweeps() {
            let open = |group| Accumulated::open(context, &buffers.specular, group, y, given);
            let sources: Vec<Accumulated> = groups.map(open).collect::<Result<_, _>>()?;
            if let Some(x) = x {
                exchange.run(context, buffers, x, &sources, monitor)?;
            }
            for of in sources {
                reflection.specular(context, &of)?;
                if let Some(front) = &of.front {
                    buffers.specular.keep(context, Specular::Current, of.group, front)?;
                }
                of.back.map_or(Ok(()), |back| back.store(&context.device))?;
            }
        }
        context.complete_slots(&context.outgoing.radiance, context.plan.rgb_bytes())?;
        reflection.diffuse(context, buffers, given, y)
    }
}

impl Adjoint for AdjointOperator<'_> {
    fn set(
        &mut self,
        irradiance: &[[f64; 4]],
        radiance: &[[f64; 4]],
        specular: &[Option<Vec<f64>>],
    ) -> Result<(), TransportError> {
        self.adjoint.buffers.set(self.context(), irradiance, radiance, specular)
    }

    fn add_view(&mut self, camera_position: DVec3, colours: &[[f64; 4]]) -> Result<(), TransportError> {
        let face_colours = self.operators.observation.colours();
        let AdjointKernels { observation, buffers, .. } = &*self.adjoint;
        observation.run(self.context(), buffers, face_colours, camera_position, colours)
    }

    fn given_specular(&mut self) -> Result<Vec<Option<Vec<f64>>>, TransportError> {
        self.specular_cotangent(Specular::Given)
    }

    fn outgoing_cotangent(&mut self, cotangent: &transport::State) -> Result<OutgoingValues, TransportError> {
        let cotangent = of(cotangent)?;
        // The bins of antiradiance go to a state that is discarded.
        let unused = self.operators.vector()?;
        self.transpose(Some(cotangent), true, &unused)?;
        let radiance = self.context().slots(&self.context().outgoing.radiance)?;
        Ok(OutgoingValues { radiance, specular: self.specular_cotangent(Specular::Current)? })
    }

    fn lobe_sums(&mut self, x: &transport::State) -> Result<Option<Vec<LobeSums>>, TransportError> {
        let x = of(x)?;
        let Some(sums) = &self.adjoint.buffers.lobe_sums else { return Ok(None) };
        let context = self.context();
        self.adjoint.reflection.derivative(context, &self.adjoint.buffers, x, sums)?;
        let Context { device, plan, .. } = context;
        let count = u64::from(plan.layout.slots()) * 8;
        let values = real::download(device, sums, plan.settings.precision, 0..count)?;
        let rgb = |v: &[f64]| DVec3::new(v[0], v[1], v[2]);
        Ok(Some(values.chunks_exact(8).map(|v| [rgb(v), rgb(&v[4..])]).collect()))
    }

    fn geometry(
        &mut self,
        x: &transport::State,
        cotangent: &transport::State,
        views: &[(DVec3, Vec<[f64; 4]>)],
        movable: Option<&Movable>,
    ) -> Result<(Vec<FacetGradient>, Vec<DVec3>), TransportError> {
        let [x, cotangent] = [of(x)?, of(cotangent)?];
        self.operators.update_outgoing(Some(x), true, true)?;
        let Forward { context, reflection, monitor, .. } = &mut *self.operators;
        let AdjointKernels { buffers, derivative, observation: of_views, .. } = &mut *self.adjoint;
        let (Some(gradients), Some(derivative)) = (&buffers.gradients, derivative) else {
            return Err(TransportError::missing("derivatives with respect to geometry"));
        };
        let count = u64::from(context.plan.layout.slots()) * 16;
        let precision = context.plan.settings.precision;
        let mut batch = context.device.batch()?;
        batch.fill(gradients, 0, count * precision.bytes(), 0)?;
        batch.defer()?;
        if let Some(movable) = movable {
            derivative.run(context, buffers, reflection, [x, cotangent], gradients, movable, monitor)?;
        }
        if context.plan.has_first_bounce() && !views.is_empty() {
            self.operators.update_outgoing(Some(x), true, false)?;
        }
        let Forward { context, observation, reflection, monitor, .. } = &mut *self.operators;
        let mut camera_positions = Vec::with_capacity(views.len());
        for (camera_position, colours) in views {
            camera_positions.push(of_views.derivative(
                context,
                (reflection, x),
                [observation.colours(), gradients],
                (*camera_position, colours),
                monitor,
            )?);
        }
        context.complete_slots(gradients, 16 * precision.bytes())?;
        let values = real::download(&context.device, gradients, precision, 0..count)?;
        Ok((values.chunks_exact(16).map(FacetGradient::of_slot).collect(), camera_positions))
    }
}

/// What the triangles of a piece send under the incident light `x`: antiradiance, and specular radiance. All ranks call it.
pub(super) fn sent<'a>(
    context: &'a Context,
    reflection: &mut Reflection,
    piece: &Piece,
    x: &'a State,
    monitor: &mut PassMonitor,
) -> Result<[BufferSlice<'a>; 2], TransportError> {
    let Context { device, plan, scene, .. } = context;
    let light = Part::of_piece(plan, piece).map(|part| x.show(device, &part)).transpose()?;
    let specular = match current_specular(context, piece)? {
        Some(specular) => specular,
        None => reflection.specular_under(context, piece, light.as_ref(), monitor)?,
    };
    Ok([light.map_or(scene.no_bins.whole(), |light| light.slice()), specular])
}

/// The specular radiance of a piece under incident light that is on the device, by this rank alone.
pub(super) fn specular_of<'a>(
    context: &'a Context,
    reflection: &mut Reflection,
    piece: &Piece,
    light: Option<&View>,
    monitor: &mut PassMonitor,
) -> Result<BufferSlice<'a>, TransportError> {
    match current_specular(context, piece)? {
        Some(specular) => Ok(specular),
        // Of a group of which this rank holds nothing.
        None if piece.part.tiles.is_empty() => Ok(context.scene.no_bins.whole()),
        None => reflection.specular_under(context, piece, light, monitor),
    }
}

/// The specular radiance of a piece, where the device has that of all at once.
fn current_specular<'a>(
    context: &'a Context,
    piece: &Piece,
) -> Result<Option<BufferSlice<'a>>, TransportError> {
    let Context { plan, scene, outgoing, .. } = context;
    let there = || page_of(&outgoing.specular, piece.group, piece.part.class.glossy, &scene.no_bins);
    plan.states_are_whole().then(there).transpose()
}

impl LightOperator for AdjointOperator<'_> {
    type Vector = transport::State;
    type Error = TransportError;

    fn vector(&mut self) -> Result<transport::State, TransportError> {
        self.operators.vector().map(|state| transport::State(transport::Values::Vulkan(state)))
    }

    fn pass(
        &mut self,
        x: Option<&transport::State>,
        emission: bool,
        y: &mut transport::State,
    ) -> Result<(), TransportError> {
        self.transpose(x.map(of).transpose()?, emission, of(y)?)
    }

    fn dot(&mut self, x: &transport::State, y: &transport::State) -> Result<f64, TransportError> {
        self.operators.dot(of(x)?, of(y)?)
    }

    fn combine(
        &mut self,
        a: f64,
        x: &transport::State,
        b: f64,
        y: &mut transport::State,
    ) -> Result<(), TransportError> {
        self.operators.combine((a, of(x)?), (b, of(y)?))
    }

    fn accumulate(
        &mut self,
        a: &[f64],
        x: &[transport::State],
        y: &mut transport::State,
    ) -> Result<(), TransportError> {
        self.operators.accumulate(a, &all(x)?, of(y)?)
    }

    fn orthonormalise(
        &mut self,
        basis: &[transport::State],
        y: &mut transport::State,
        spanned: f64,
    ) -> Result<Orthonormalised, TransportError> {
        let [column, _] = self.operators.orthonormal(&all(basis)?, of(y)?, spanned, false)?;
        Ok(Orthonormalised { column, judged: None })
    }

    fn scale(&mut self, b: f64, y: &mut transport::State) -> Result<(), TransportError> {
        self.operators.scale(b, of(y)?)
    }

    /// All entries count: which of them matter depends on the loss.
    fn judged(&mut self, _: &transport::State) -> Result<Option<Vec<f64>>, TransportError> {
        Ok(None)
    }
}
