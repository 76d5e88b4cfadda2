//! States as vectors, for the solvers.

use super::bundle::PassMonitor;
use super::residency::{Part, View};
use super::state::State;
use super::{Context, WORKGROUP, real};
use crate::plan::{ALL_SUMS, LONGEST_RESTART, PARTIAL_SUMS, Plan, Residency};
use crate::shaders::{self, RealShader};
use crate::transport::TransportError;
use antirad_gpu::{Batch, Buffer, BufferKind, BufferSlice, Device, GpuError, Pipeline};
use antirad_scene::Precision;
use bytemuck::{Pod, Zeroable, bytes_of};

/// `DotPush` of crates/core/glsl/dot.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct DotPush {
    /// Fours of reals in each of the two vectors.
    pub count: u32,
    /// 1 to add to the sums of an earlier dispatch.
    pub add: u32,
}

/// `ProjectPush` of crates/core/glsl/project.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct ProjectPush {
    /// Fours of reals in each of the vectors.
    pub count: u32,
    /// 1 to add to the sums of an earlier dispatch of the same number.
    pub add: u32,
    /// 1 for ⟨y, y⟩.
    pub norm: u32,
    /// Number of the step of the projection, from 0.
    pub number: u32,
}

/// Lanes that process a vector; each writes one partial sum.
const LANES: u32 = PARTIAL_SUMS as u32;
/// Reals that a lane processes at a time. Parts of states are multiples of it.
const STEP: u32 = 4;
/// Workgroups of a dispatch that sums.
const GROUPS: [u32; 3] = [LANES / WORKGROUP, 1, 1];

pub struct Vectors {
    combine: Pipeline,
    dot: Pipeline,
    project: Pipeline,
    normalise: Pipeline,
    partial: Buffer,
}

impl Vectors {
    pub fn new(device: &Device, precision: Precision) -> Result<Self, GpuError> {
        let [combine, dot, project, normalise] = Self::kernels(device, precision)?;
        let partial = Buffer::new(device, "partial sums", ALL_SUMS * precision.bytes(), BufferKind::Storage)?;
        Ok(Self { combine, dot, project, normalise, partial })
    }

    /// Compiles the kernels, in the order of the fields of [`Vectors`].
    ///
    /// # Errors
    /// Fails if the device cannot compile one.
    pub fn kernels(device: &Device, precision: Precision) -> Result<[Pipeline; 4], GpuError> {
        let kernel = |shader: &'static RealShader, buffers: u32, push: u32, constants: &[(u32, u32)]| {
            Pipeline::new(device, shader.of(precision), buffers, push, constants)
        };
        let (dot, project) = (size_of::<DotPush>() as u32, size_of::<ProjectPush>() as u32);
        Ok([
            kernel(&shaders::COMBINE, 2, real::push_bytes(precision, 2, 1), &[(0, WORKGROUP)])?,
            kernel(&shaders::DOT, 3, dot, &[(0, WORKGROUP)])?,
            kernel(&shaders::PROJECT, 4, project, &[])?,
            kernel(&shaders::NORMALISE, 2, real::push_bytes(precision, 2, 2), &[])?,
        ])
    }

    /// y = 0.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn clear(&self, context: &Context, y: &State) -> Result<(), TransportError> {
        for parts in together(&context.plan) {
            let views = parts.iter().map(|part| y.edit(&context.device, part, false));
            let views: Vec<View> = views.collect::<Result<_, _>>()?;
            let mut batch = context.device.batch()?;
            views.iter().try_for_each(|view| view.fill(&mut batch))?;
            batch.submit()?;
            views.into_iter().try_for_each(|view| view.store(&context.device))?;
        }
        Ok(())
    }

    /// y = a x + b y.
    ///
    /// # Errors
    /// Fails if the device does, or if the callback stops the pass.
    pub fn combine(
        &self,
        context: &Context,
        (a, x): (f64, &State),
        (b, y): (f64, &State),
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let precision = plan.settings.precision;
        for parts in together(plan) {
            let views = parts.iter().map(|part| Ok((x.read(device, part)?, y.edit(device, part, b != 0.0)?)));
            let views: Vec<(View, View)> = views.collect::<Result<_, TransportError>>()?;
            let mut batch = device.batch()?;
            for (x, y) in &views {
                let count = y.reals(precision) / STEP;
                self.record_combine(&mut batch, precision, (a, x.slice()), (b, y.slice()), count)?;
            }
            batch.submit()?;
            views.into_iter().try_for_each(|(_, y)| y.store(device))?;
            monitor.done(0)?;
        }
        Ok(())
    }

    fn record_combine(
        &self,
        batch: &mut Batch,
        precision: Precision,
        (a, x): (f64, BufferSlice),
        (b, y): (f64, BufferSlice),
        count: u32,
    ) -> Result<(), GpuError> {
        let push = real::push(precision, &[a, b], &[count]);
        let groups = [count.div_ceil(WORKGROUP).min(LANES / WORKGROUP), 1, 1];
        batch.dispatch(&self.combine, "vector", &[x, y], &push, groups)
    }

    /// y = b y, as b x + 0 y with x = y.
    ///
    /// # Errors
    /// Fails if the device does, or if the callback stops the pass.
    pub fn scale(
        &self,
        context: &Context,
        b: f64,
        y: &State,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        self.combine(context, (b, y), (0.0, y), monitor)
    }

    /// ⟨x, y⟩.
    ///
    /// # Errors
    /// Fails if the device does, if another rank has ended, or if the callback stops the pass.
    pub fn dot(
        &self,
        context: &Context,
        x: &State,
        y: &State,
        monitor: &mut PassMonitor,
    ) -> Result<f64, TransportError> {
        let Context { device, plan, .. } = context;
        let precision = plan.settings.precision;
        let mut additions = additions();
        let mut known = None;
        // Each rank holds its own bins; the first sums up irradiance.
        let counts = |part: &Part| plan.options.rank == 0 || !matches!(part, Part::Irradiance { .. });
        let parts: Vec<Vec<Part>> =
            together(plan).into_iter().map(|parts| parts.into_iter().filter(counts).collect()).collect();
        if parts.iter().all(Vec::is_empty) {
            known = Some(0.0);
        }
        for parts in parts.into_iter().filter(|parts| !parts.is_empty()) {
            let views = parts.iter().map(|part| Ok((x.read(device, part)?, y.edit(device, part, true)?)));
            let views: Vec<(View, View)> = views.collect::<Result<_, TransportError>>()?;
            let mut batch = device.batch()?;
            for ((x, y), add) in views.iter().zip(&mut additions) {
                let push = DotPush { count: y.reals(precision) / STEP, add };
                let buffers = [x.slice(), y.slice(), self.partial.whole()];
                batch.dispatch(&self.dot, "vector", &buffers, bytes_of(&push), GROUPS)?;
            }
            batch.submit()?;
            monitor.done(0)?;
        }
        let own = known.map_or_else(|| self.sum(context), Ok)?;
        let of_all = device.ranks().each([own.to_bits()])?.into_iter();
        Ok(of_all.map(|[bits]| f64::from_bits(bits)).sum())
    }

    /// y = Σ aᵢ xᵢ + y, in one submission where states are on the device.
    ///
    /// # Errors
    /// Fails if the device does, or if the callback stops the pass.
    pub fn accumulate(
        &self,
        context: &Context,
        a: &[f64],
        x: &[State],
        y: &State,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let mut terms = a.iter().zip(x);
        if in_steps(context) {
            return terms.try_for_each(|(a, x)| self.combine(context, (*a, x), (1.0, y), monitor));
        }
        let parts = Part::own(plan);
        let (y, precision) = (y.resident()?, plan.settings.precision);
        let mut batch = device.batch()?;
        for (a, x) in terms {
            for part in &parts {
                let x = x.resident()?.part(part)?;
                let (y, count) = (y.part(part)?, fours(part.bytes(), precision));
                self.record_combine(&mut batch, precision, (*a, x), (1.0, y), count)?;
            }
        }
        batch.submit()?;
        monitor.done(0)
    }

    /// A step of Arnoldi's iteration, see [`crate::solve::LightOperator::orthonormalise`]: its column, and with `judged` the irradiance of
    /// the new vector.
    ///
    /// # Errors
    /// Fails if the device does, if another rank has ended, or if the callback stops the pass.
    pub fn orthonormalise(
        &self,
        context: &Context,
        basis: &[State],
        y: &State,
        spanned: f64,
        judged: bool,
        monitor: &mut PassMonitor,
    ) -> Result<[Vec<f64>; 2], TransportError> {
        let [mut column, irradiance] = match basis.last() {
            Some(last) if !in_steps(context) && basis.len() <= LONGEST_RESTART as usize => {
                self.project(context, (last, basis), y, spanned, judged, monitor)?
            }
            _ => {
                let Context { device, plan, .. } = context;
                let column = self.project_in_steps(context, basis, y, monitor)?;
                self.normalise(context, column.last().copied().unwrap_or(0.0), spanned, y, monitor)?;
                let read = || y.download(device, &Part::irradiance(plan), plan.settings.precision);
                [column, if judged { read()? } else { Vec::new() }]
            }
        };
        if let Some(square) = column.last_mut() {
            *square = square.sqrt();
        }
        Ok([column, irradiance])
    }

    /// y = y / ‖y‖ with `square` = ⟨y, y⟩, or 0 where the norm is no larger than `spanned`.
    fn normalise(
        &self,
        context: &Context,
        square: f64,
        spanned: f64,
        y: &State,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let precision = plan.settings.precision;
        for part in together(plan).into_iter().flatten() {
            let view = y.edit(device, &part, true)?;
            let mut batch = device.batch()?;
            let count = view.reals(precision) / STEP;
            self.record_normalise(&mut batch, precision, [spanned, square], (view.slice(), count), 0)?;
            batch.submit()?;
            view.store(device)?;
        }
        monitor.done(0)
    }

    /// `number`: of dispatches before that sum up, the last of them ⟨y, y⟩; 0 where that is `square`.
    fn record_normalise(
        &self,
        batch: &mut Batch,
        precision: Precision,
        [spanned, square]: [f64; 2],
        (y, count): (BufferSlice, u32),
        number: u32,
    ) -> Result<(), GpuError> {
        let push = real::push(precision, &[spanned, square], &[count, number]);
        batch.dispatch(&self.normalise, "vector", &[y, self.partial.whole()], &push, GROUPS)
    }

    /// y = last - y, then y minus its projections onto the basis, normalised: the coefficient of each, and ⟨y, y⟩ before that; and with
    /// `judged` its irradiance. All in one submission, since each kernel sums up itself what the one before it has multiplied.
    fn project(
        &self,
        Context { device, plan, .. }: &Context,
        (last, basis): (&State, &[State]),
        y: &State,
        spanned: f64,
        judged: bool,
        monitor: &mut PassMonitor,
    ) -> Result<[Vec<f64>; 2], TransportError> {
        let precision = plan.settings.precision;
        let parts = Part::all(plan);
        let target = y.resident()?;
        // What the dispatches of each number read, and what they multiply by: y = last - y, ⟨v₀, y⟩; y = y - h₀ v₀, ⟨v₁, y⟩; and so
        // on, at the end ⟨y, y⟩.
        let read = std::iter::once(last).chain(basis);
        let multiplied = basis.iter().map(Some).chain([None]);
        let mut batch = device.batch()?;
        for ((x, z), number) in read.zip(multiplied).zip(0..) {
            for (part, add) in parts.iter().zip(additions()) {
                let count = fours(part.bytes(), precision);
                let push = ProjectPush { count, add, norm: u32::from(z.is_none()), number };
                let [x, z] = [x, z.unwrap_or(y)].map(|state| state.resident()?.part(part));
                let buffers = [x?, target.part(part)?, z?, self.partial.whole()];
                batch.dispatch(&self.project, "vector", &buffers, bytes_of(&push), GROUPS)?;
            }
        }
        let number = basis.len() as u32 + 1;
        for part in &parts {
            let of = (target.part(part)?, fours(part.bytes(), precision));
            self.record_normalise(&mut batch, precision, [spanned, 0.0], of, number)?;
        }
        let (real, sums) = (precision.bytes(), 2 * u64::from(LANES));
        let column = self.partial.slice(sums * real, u64::from(number) * real);
        let irradiance = judged.then(|| target.view(&Part::irradiance(plan))).transpose()?;
        let read: Vec<BufferSlice> =
            std::iter::once(column).chain(irradiance.map(|view| view.own())).collect();
        let (read, timing) = batch.submit_and_read(&read)?;
        monitor.executed(timing.wall_seconds)?;
        let mut read = read.iter().map(|bytes| real::decode(precision, bytes));
        Ok(std::array::from_fn(|_| read.next().unwrap_or_default()))
    }

    /// y = last - y, then y minus its projections onto the basis, one submission after the other: the
    /// coefficient of each, and ⟨y, y⟩ afterwards.
    fn project_in_steps(
        &self,
        context: &Context,
        basis: &[State],
        y: &State,
        monitor: &mut PassMonitor,
    ) -> Result<Vec<f64>, TransportError> {
        let mut column = vec![match basis.last() {
            Some(x) => self.combine_dot(context, (1.0, x), (-1.0, y), basis.first(), monitor)?,
            None => self.dot(context, y, y, monitor)?,
        }];
        for (number, v) in basis.iter().enumerate() {
            let h = column[number];
            column.push(self.combine_dot(context, (-h, v), (1.0, y), basis.get(number + 1), monitor)?);
        }
        Ok(column)
    }

    /// y = a x + b y; then ⟨z, y⟩, or ⟨y, y⟩ without z.
    fn combine_dot(
        &self,
        context: &Context,
        (a, x): (f64, &State),
        (b, y): (f64, &State),
        z: Option<&State>,
        monitor: &mut PassMonitor,
    ) -> Result<f64, TransportError> {
        // On the host only one vector to read is on the device at a time.
        self.combine(context, (a, x), (b, y), monitor)?;
        self.dot(context, z.unwrap_or(y), y, monitor)
    }

    /// The sum of the partial sums.
    fn sum(&self, Context { device, plan, .. }: &Context) -> Result<f64, TransportError> {
        let precision = plan.settings.precision;
        Ok(total(precision, &real::download(device, &self.partial, precision, 0..LANES.into())?))
    }
}

/// Whether each operation takes effect before the next: ranks sum up, or vectors are on the host, where only one to read is on the device at
/// a time.
fn in_steps(Context { plan, .. }: &Context) -> bool {
    !plan.states_are_whole()
}

/// The sum of partial sums as crates/core/glsl/project.comp has it, to the last bit: with vectors in host memory solvers take the same steps.
fn total(precision: Precision, partial: &[f64]) -> f64 {
    fn sum<T: Copy + Default + std::ops::Add<Output = T>>(partial: &[f64], real: fn(f64) -> T) -> T {
        let lanes = WORKGROUP as usize;
        let of_lane =
            |lane| partial.iter().skip(lane).step_by(lanes).fold(T::default(), |sum, x| sum + real(*x));
        (0..lanes).map(of_lane).fold(T::default(), |sum, x| sum + x)
    }
    match precision {
        Precision::F32 => sum(partial, |x| x as f32).into(),
        Precision::F64 => sum(partial, |x| x),
    }
}

/// Fours of reals in so many bytes.
fn fours(bytes: u64, precision: Precision) -> u32 {
    (bytes / precision.bytes()) as u32 / STEP
}

/// Parts of states in groups that the device can access together: on the host, parts take turns in the windows.
fn together(plan: &Plan) -> Vec<Vec<Part>> {
    match plan.residency {
        Residency::Device => vec![Part::own(plan)],
        Residency::Host { .. } => Part::own(plan).into_iter().map(|part| vec![part]).collect(),
    }
}

/// Whether the dispatch of each part adds to the sums of those before: all but the first, wherever parts are, so that not
/// a bit depends on it.
fn additions() -> impl Iterator<Item = u32> {
    std::iter::once(0).chain(std::iter::repeat(1))
}
