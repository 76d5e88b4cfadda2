//! The transposed operators as one for the solvers: λ = λ₀ + (K - J)ᵀ (μ₀ + Uᵀ λ), with λ the cotangent of what arrives and
//! μ that of what leaves. A state of the adjoint holds the cotangents of irradiance and, per bin, of H(b).

use super::exchange_adjoint::ExchangeAdjoint;
use super::exchange_derivative::ExchangeDerivative;
use super::observation_adjoint::ObservationAdjoint;
use super::reflection_adjoint::ReflectionAdjoint;
use super::state::{State, StateBuffers, page, pages};
use super::watch::TransportError;
use super::{Context, Operators, real};
use crate::gpu::{Buffer, BufferKind, Device, GpuError};
use crate::model::FacetGradient;
use crate::plan::{PairLists, Plan};
use crate::solve::LightOperator;
use glam::DVec3;

/// The loss's own cotangents, and where gradients are summed up.
pub struct AdjointBuffers {
    /// λ₀: of irradiance, vec4 per slot.
    pub irradiance: Buffer,
    /// μ₀: of radiance, vec4 per slot.
    pub radiance: Buffer,
    /// μ₀: of specular radiance, per glossy group.
    pub specular: Vec<Option<Buffer>>,
    /// λ of irradiance in the state that is worked on, vec4 per slot, as point-to-point kernels read it of others: it
    /// goes on behind the last slot, which states don't.
    pub shown: Buffer,
    /// [`crate::plan::FarRuns`] by source.
    pub far_runs: Buffer,
    pub near_offsets: Buffer,
    pub near_receivers: Buffer,
    /// `FacetGradient` of glsl/facet_gradient.glsl, per slot.
    gradients: Option<Buffer>,
    /// Two vec4 per slot: glsl/reflect_glossy_derivative.comp.
    lobe_sums: Option<Buffer>,
}

/// All that a backward pass needs beyond the operators.
pub struct Adjoint {
    pub(super) buffers: AdjointBuffers,
    exchange: ExchangeAdjoint,
    reflection: ReflectionAdjoint,
    observation: ObservationAdjoint,
    derivative: Option<ExchangeDerivative>,
}

/// What a loss has to say about specular parameters of a slot: Σ_ob μ(o) lobe H(b), and the same with ln⟨h,n⟩.
pub type LobeSums = [DVec3; 2];

impl Adjoint {
    /// What the plan has foreseen; nothing if it wants no gradients.
    pub fn new(device: &Device, plan: &Plan) -> Result<Option<Self>, GpuError> {
        let Some(PairLists { far, near }) = &plan.interactions().by_source else { return Ok(None) };
        let wanted = plan.limits.gradients;
        let rgb = u64::from(plan.layout.slots()) * plan.rgb_bytes();
        let storage = |label: &str, bytes: u64| Buffer::new(device, label, bytes, BufferKind::Storage);
        let words = |label: &str, words: &[u32]| -> Result<Buffer, GpuError> {
            let buffer = storage(label, words.len() as u64 * 4)?;
            device.upload_slice(&buffer, 0, words)?;
            Ok(buffer)
        };
        let lobes = wanted.lobes() && plan.classes.iter().any(|class| class.glossy);
        let geometry = wanted.geometry();
        let buffers = AdjointBuffers {
            irradiance: storage("cotangent: irradiance", rgb)?,
            radiance: storage("cotangent: radiance", rgb)?,
            specular: pages(device, plan, "cotangent: specular", |group| group.class.glossy)?,
            shown: storage("cotangent: receivers", rgb + u64::from(plan.other_slots()) * plan.rgb_bytes())?,
            far_runs: words("far runs, by source", far.words())?,
            near_offsets: words("near offsets, by source", &near.offsets)?,
            near_receivers: words("near receivers", &near.others)?,
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
    /// Sets the loss's own cotangents: λ₀ of irradiance and μ₀ of radiance, per slot, and of specular radiance per group,
    /// laid out like the bins of a state.
    fn set(
        &self,
        context: &Context,
        irradiance: &[[f64; 4]],
        radiance: &[[f64; 4]],
        specular: &[Option<Vec<f64>>],
    ) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let precision = plan.accuracy.precision;
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

    /// Copies the cotangent of irradiance to where point-to-point kernels read it of others.
    pub fn show(&self, context: &Context, cotangent: &StateBuffers) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let mut batch = device.batch()?;
        batch.copy(&cotangent.irradiance, 0, &self.shown, 0, plan.irradiance_bytes())?;
        batch.submit()?;
        Ok(())
    }

    /// Makes what leaves the loss's own cotangent μ₀ of it, or zero.
    fn start(&self, context: &Context, given: bool) -> Result<(), TransportError> {
        let Context { device, plan, leaving, .. } = context;
        let rgb = u64::from(plan.layout.slots()) * plan.rgb_bytes();
        let mut copies = vec![(&self.radiance, &leaving.radiance, rgb)];
        for (g, group) in plan.glossy_groups() {
            copies.push((page(&self.specular, g)?, page(&leaving.specular, g)?, plan.page_bytes(group)));
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
    adjoint: &'a mut Adjoint,
}

impl<'a> AdjointOperator<'a> {
    /// Borrows both for one solve; [`Self::set`] comes first.
    pub fn new(operators: &'a mut Operators, adjoint: &'a mut Adjoint) -> Self {
        Self { operators, adjoint }
    }

    fn context(&self) -> &Context {
        &self.operators.context
    }

    /// Sets the loss's own cotangents: λ₀ of irradiance and μ₀ of radiance, per slot, and μ₀ of specular radiance per group,
    /// laid out like [`Operators::bins`].
    pub fn set(
        &mut self,
        irradiance: &[[f64; 4]],
        radiance: &[[f64; 4]],
        specular: &[Option<Vec<f64>>],
    ) -> Result<(), TransportError> {
        self.adjoint.buffers.set(self.context(), irradiance, radiance, specular)
    }

    /// Adds the cotangent of what every slot sends to `eye` (metres).
    pub fn add_view(&mut self, eye: DVec3, colours: &[[f64; 4]]) -> Result<(), TransportError> {
        let face_colours = self.operators.observation.colours();
        let Adjoint { observation, buffers, .. } = &*self.adjoint;
        observation.run(self.context(), buffers, face_colours, eye, colours)
    }

    /// μ = μ₀ + Uᵀ λ, the cotangent of what leaves: of radiance per slot, and of specular radiance per group. It stays on the
    /// device until the next use of the operators.
    pub fn worth_of_leaving(&mut self, cotangent: &State) -> Result<super::LeavingValues, TransportError> {
        // The bins of antiradiance go to a state that nobody reads.
        let mut unused = self.vector()?;
        self.transpose(Some(cotangent), true, &mut unused)?;
        Ok(self.operators.leaving_values()?)
    }

    /// Per slot, what specular parameters are worth, after [`Self::worth_of_leaving`]. `None` where nothing is glossy.
    pub fn lobe_sums(&mut self, x: &State) -> Result<Option<Vec<LobeSums>>, TransportError> {
        let Some(sums) = &self.adjoint.buffers.lobe_sums else { return Ok(None) };
        let context = self.context();
        self.adjoint.reflection.derivative(context, x, sums)?;
        let Context { device, plan, .. } = context;
        let count = u64::from(plan.layout.slots()) * 8;
        let values = real::download(device, sums, plan.accuracy.precision, count)?;
        let rgb = |v: &[f64]| DVec3::new(v[0], v[1], v[2]);
        Ok(Some(values.chunks_exact(8).map(|v| [rgb(v), rgb(&v[4..])]).collect()))
    }

    /// Per slot, the derivative of ⟨λ, U (E + (K - J) x)⟩ and of the views' ⟨colours, S (E + K x)⟩ with respect to geometry,
    /// and of the latter with respect to each eye; per unit of length of the engine. Makes the fronts emit and
    /// reflect again.
    pub fn geometry(
        &mut self,
        x: &State,
        cotangent: &State,
        views: &[(DVec3, Vec<[f64; 4]>)],
        pairs: bool,
    ) -> Result<(Vec<FacetGradient>, Vec<DVec3>), TransportError> {
        self.operators.leave(Some(x), true)?;
        let Operators { context, observation, watch, .. } = &mut *self.operators;
        let Adjoint { buffers, derivative, observation: views_derivative, .. } = &mut *self.adjoint;
        let (Some(gradients), Some(derivative)) = (&buffers.gradients, derivative) else {
            return Err(TransportError::missing("derivatives with respect to geometry"));
        };
        let count = u64::from(context.plan.layout.slots()) * 16;
        let precision = context.plan.accuracy.precision;
        let mut batch = context.device.batch()?;
        batch.fill(gradients, 0, count * precision.bytes(), 0)?;
        batch.submit()?;
        if pairs {
            derivative.run(context, buffers, x, cotangent, gradients, watch)?;
        }
        let mut eyes = Vec::with_capacity(views.len());
        for (eye, colours) in views {
            let face_colours = observation.colours();
            eyes.push(views_derivative.derivative(context, face_colours, gradients, *eye, colours)?);
        }
        let values = real::download(&context.device, gradients, precision, count)?;
        let gradient = |v: &[f64]| {
            let vector = |at: usize| DVec3::new(v[at], v[at + 1], v[at + 2]);
            FacetGradient {
                corners: [vector(0), vector(4), vector(8)],
                normal: vector(12),
                area: v[3],
                extent: v[7],
            }
        };
        Ok((values.chunks_exact(16).map(gradient).collect(), eyes))
    }

    /// y = [given] λ₀ + (K - J)ᵀ ([given] μ₀ + Uᵀ x), leaving the cotangent of what leaves behind.
    fn transpose(&mut self, x: Option<&State>, given: bool, y: &mut State) -> Result<(), TransportError> {
        let Operators { context, vectors, watch, .. } = &mut *self.operators;
        let Adjoint { buffers, exchange, reflection, .. } = &mut *self.adjoint;
        vectors.clear(context, y)?;
        buffers.start(context, given)?;
        if let Some(x) = x {
            exchange.run(context, buffers, x, y, watch)?;
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

    fn scale(&mut self, b: f64, y: &mut State) -> Result<(), TransportError> {
        self.operators.scale(b, y)
    }

    /// The 2-norm of all entries: what matters of a cotangent depends on the loss, so all of it counts.
    fn magnitude(&mut self, x: &State) -> Result<f64, TransportError> {
        Ok(self.operators.dot(x, x)?.sqrt())
    }
}
