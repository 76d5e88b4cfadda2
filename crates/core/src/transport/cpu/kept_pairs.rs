//! Far pairs that are kept from pass to pass. What passes between two triangles depends on where they are, not on the light; to evaluate it
//! takes most of a pass of triangles with bins.

use super::clusters::Sources;
use super::exchange::{blocks, light};
use super::far::{self, N, Received};
use super::pairs::Pairs;
use super::real::Real;
use super::scene::Context;
use super::taps::Tap;
use crate::backend::Lease;
use crate::plan::{PAIR_BACK, PAIR_FRONT, PAIR_NEAR};
use crate::transport::shape::Shape;
use antirad_base::parallel;
use antirad_base::usage::OverBudget;
use std::ops::Range;

/// What passes to the receivers of a block.
pub struct KeptPairs<T> {
    /// Ascending by source.
    sources: Vec<KeptSource>,
    /// Of each pair, by source and receiver: what passes, negative from backs.
    weights: Vec<T>,
    /// The bins of the receiver of each pair, if it has bins.
    at_receiver: Vec<Tap<T>>,
    /// The bins of the source of pairs whose light comes from bins.
    at_source: Vec<Tap<T>>,
}

/// The pairs of a source.
#[derive(Clone, Copy)]
struct KeptSource {
    source: u32,
    /// A bit for each receiver that it sends light to.
    receivers: u32,
    /// Where its pairs begin, and its taps.
    pair: u32,
    tap: u32,
}

/// What passes from a source to a receiver.
pub struct KeptPair<'a, T> {
    /// Place of the receiver in its block.
    pub receiver: usize,
    /// Negative from the back of the source.
    pub weight: T,
    pub at_receiver: Option<&'a Tap<T>>,
    pub at_source: Option<&'a Tap<T>>,
}

impl<T: Real> KeptPairs<T> {
    pub const NONE: Self =
        Self { sources: Vec::new(), weights: Vec::new(), at_receiver: Vec::new(), at_source: Vec::new() };

    pub fn push(&mut self, source: u32, pairs: &Pairs<T, N>, shape: Shape) {
        let (pair, tap) = (self.weights.len() as u32, self.at_source.len() as u32);
        let mut receivers = 0;
        for k in (0..N).filter(|&k| pairs.weight[k] > T::ZERO) {
            receivers |= 1 << k;
            let front = pairs.front[k] > T::ZERO;
            self.weights.push(if front { pairs.weight[k] } else { -pairs.weight[k] });
            if shape.receiver_bins {
                self.at_receiver.push(pairs.at_receiver.tap(k));
            }
            if !front || shape.source.glossy {
                self.at_source.push(pairs.at_source.tap(k));
            }
        }
        self.sources.push(KeptSource { source, receivers, pair, tap });
    }

    fn shrink(mut self) -> Self {
        self.sources.shrink_to_fit();
        self.weights.shrink_to_fit();
        self.at_receiver.shrink_to_fit();
        self.at_source.shrink_to_fit();
        self
    }

    /// The sources in a range, each with its pairs, by receiver. `glossy`: whether fronts send light from bins.
    #[inline(always)]
    pub fn of(&self, sources: &Range<u32>, glossy: bool) -> impl Iterator<Item = (u32, PairsOf<'_, T>)> {
        let before = |bound: u32| self.sources.partition_point(|of| of.source < bound);
        let own = &self.sources[before(sources.start)..before(sources.end)];
        own.iter().map(move |&of| (of.source, PairsOf { kept: self, left: of, glossy }))
    }
}

/// The pairs of a source and the receivers of a block.
pub struct PairsOf<'a, T> {
    kept: &'a KeptPairs<T>,
    left: KeptSource,
    glossy: bool,
}

impl<'a, T: Real> Iterator for PairsOf<'a, T> {
    type Item = KeptPair<'a, T>;

    #[inline(always)]
    fn next(&mut self) -> Option<Self::Item> {
        let Self { kept, left, glossy } = self;
        if left.receivers == 0 {
            return None;
        }
        let receiver = left.receivers.trailing_zeros() as usize;
        left.receivers &= left.receivers - 1;
        let weight = kept.weights[left.pair as usize];
        let at_receiver = kept.at_receiver.get(left.pair as usize);
        left.pair += 1;
        let from_bins = *glossy || weight < T::ZERO;
        let at_source = if from_bins { kept.at_source.get(left.tap as usize) } else { None };
        left.tap += u32::from(from_bins);
        Some(KeptPair { receiver, weight, at_receiver, at_source })
    }
}

/// The kept pairs of two groups, by block of receivers.
type Blocks<T> = Vec<KeptPairs<T>>;

/// All far pairs of triangles of which one has bins.
pub struct KeptFar<T> {
    /// By receiving group and group of sources.
    groups: Vec<Vec<Blocks<T>>>,
    _memory: Lease,
}

impl<T: Real> KeptFar<T> {
    /// Evaluates what passes; `None` where the plan keeps nothing.
    pub fn new(context: &Context<T>) -> Result<Option<Self>, OverBudget> {
        let plan = &context.plan;
        let Some(bytes) = plan.kept_far_bytes() else { return Ok(None) };
        let memory = context.cpu.lease("far pairs", bytes)?;
        let of = |to: usize, from: usize| -> Blocks<T> {
            let [to, from] = [to, from].map(|group| &plan.layout.groups[group]);
            let shape = Shape::new(from.class, to.class);
            if !shape.any_bins() || !plan.anything_passes(&to.tiles, &from.tiles) {
                return Vec::new();
            }
            let slots = plan.layout.slots_of(&to.tiles);
            let received = Received {
                shape,
                from: far::triangles(plan, from),
                passing: PAIR_FRONT | PAIR_NEAR | PAIR_BACK,
                light: light(
                    context,
                    &[],
                    &Sources { class: from.class, indices: 0..0, antiradiance: &[], specular: &[] },
                ),
                sources_page: plan.layout.slots_of(&from.tiles).start,
                receivers_page: slots.start,
                kept: None,
            };
            let keep = |pairs: &mut Pairs<T, N>, block| received.keep(block, pairs).shrink();
            parallel::map_init(blocks(&slots), || Pairs::NONE, keep)
        };
        let groups = 0..plan.layout.groups.len();
        let groups = groups.clone().map(|to| groups.clone().map(|from| of(to, from)).collect()).collect();
        Ok(Some(Self { groups, _memory: memory }))
    }

    /// The blocks of a receiving group with the sources of another; `None` where nothing is kept.
    pub fn of(&self, to: usize, from: usize) -> Option<&[KeptPairs<T>]> {
        Some(&self.groups[to][from][..]).filter(|blocks| !blocks.is_empty())
    }
}
