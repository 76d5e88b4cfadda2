//! The intensities of volume clusters per bin. Twin of glsl/volume_bins.comp and gather_bins.comp.

use super::on_threads;
use super::pairs::{Facet, dot, times};
use super::real::Real;
use super::taps::{Layout, Taps, add};
use crate::gpu::{BufferSlice, Device, GpuError};
use crate::model::{Class, VolumeParts, Volumes};
use crate::plan::Plan;
use crate::scene::Precision;
use rayon::prelude::*;
use std::ops::Range;

/// Directions at a time.
const N: usize = 32;
/// Numbers of an RGB value of a slot, and of a bin in the table.
const SLOT: usize = 4;

/// The bins of all volumes, below the horizon and above.
pub struct VolumeBins<'a> {
    pub volumes: &'a Volumes,
    pub own: [BufferSlice<'a>; 2],
}

impl VolumeBins<'_> {
    /// Adds to some volumes of triangles what those of a class send, the slots of a page: of radiance, antiradiance, specular radiance and
    /// the table of bins. `None` where kernels must do it.
    pub fn add(
        &self,
        device: &Device,
        plan: &Plan,
        from: (Class, &Range<u32>, &Range<u32>),
        facets: BufferSlice,
        sent: [BufferSlice; 4],
    ) -> Result<Option<()>, GpuError> {
        match plan.settings.precision {
            Precision::F32 => self.add_as::<f32>(device, plan, from, facets, sent),
            Precision::F64 => self.add_as::<f64>(device, plan, from, facets, sent),
        }
    }

    /// Sums up those that consist of others. `None` where kernels must do it.
    pub fn sum(&self, device: &Device, plan: &Plan, facets: BufferSlice) -> Result<Option<()>, GpuError> {
        match plan.settings.precision {
            Precision::F32 => self.sum_as::<f32>(device, plan, facets),
            Precision::F64 => self.sum_as::<f64>(device, plan, facets),
        }
    }

    fn add_as<T: Real>(
        &self,
        device: &Device,
        plan: &Plan,
        (class, slots, to): (Class, &Range<u32>, &Range<u32>),
        facets: BufferSlice,
        [radiance, antiradiance, specular, bin_table]: [BufferSlice; 4],
    ) -> Result<Option<()>, GpuError> {
        let layout = Layout::<T>::of(plan);
        let reals = layout.count * layout.channels;
        let Self { volumes, own } = self;
        let others = [facets, radiance, antiradiance, specular, bin_table];
        device.edit_on_host(
            *own,
            others,
            |[below, above], [facets, radiance, antiradiance, specular, bins]| {
                let sent = Sent {
                    layout,
                    class,
                    first: slots.start,
                    facets,
                    radiance,
                    antiradiance,
                    specular,
                    bins,
                };
                let first = volumes.run().range().start;
                let add = |volume: usize, below: &mut [T], above: &mut [T]| {
                    let VolumeParts::Triangles(at) = &volumes.parts()[volume] else { return };
                    let all = &volumes.slots()[at.start as usize..at.end as usize];
                    let before = |bound: u32| all.partition_point(|&slot| slot < bound);
                    let all = &all[before(slots.start)..before(slots.end)];
                    if !all.is_empty() {
                        let area = Facet::read(facets, first + volume as u32).area;
                        sent.add(all, T::ONE / area, below, above);
                    }
                };
                let numbers = to.start as usize - first as usize..to.end as usize - first as usize;
                let part = numbers.start * reals..numbers.end * reals;
                let [below, above] = [&mut below[part.clone()], &mut above[part]];
                let own = below.par_chunks_mut(reals).zip(above.par_chunks_mut(reals)).zip(numbers);
                on_threads(|| own.for_each(|((below, above), volume)| add(volume, below, above)));
            },
        )
    }

    fn sum_as<T: Real>(
        &self,
        device: &Device,
        plan: &Plan,
        facets: BufferSlice,
    ) -> Result<Option<()>, GpuError> {
        let reals = plan.bins.count() * plan.channels as usize;
        let Self { volumes, own } = self;
        let first = volumes.run().range().start;
        device.edit_on_host(*own, [facets], |own: [&mut [T]; 2], [facets]| {
            for bins in own {
                for of in volumes.run().heights.iter().skip(1) {
                    // Parts come before what they make up.
                    let (before, own) = bins.split_at_mut((of.start - first) as usize * reals);
                    let summed = |(own, index): (&mut [T], u32)| {
                        let VolumeParts::Volumes(both) = &volumes.parts()[(index - first) as usize] else {
                            return;
                        };
                        let area = Facet::read(facets, index).area;
                        let [a, b] = both.map(|part| Facet::read(facets, part).area / area);
                        let [one, other] =
                            both.map(|part| &before[(part - first) as usize * reals..][..reals]);
                        for ((own, &one), &other) in own.iter_mut().zip(one).zip(other) {
                            *own = a * one + b * other;
                        }
                    };
                    let own = own[..of.len() * reals].par_chunks_mut(reals).zip(of.clone());
                    on_threads(|| own.for_each(summed));
                }
            }
        })
    }
}

/// What triangles of one class send, in memory; `first`: the slot with which their bins begin.
struct Sent<'a, T> {
    layout: Layout<T>,
    class: Class,
    first: u32,
    facets: &'a [T],
    radiance: &'a [T],
    antiradiance: &'a [T],
    specular: &'a [T],
    bins: &'a [T],
}

impl<T: Real> Sent<'_, T> {
    /// Adds what some of them send to the bins of their volume, times `factor`.
    fn add(&self, slots: &[u32], factor: T, below: &mut [T], above: &mut [T]) {
        let Layout { count, channels, .. } = self.layout;
        let mut taps = Taps::<T, N>::NONE;
        let (mut cosines, mut centres) = ([T::ZERO; N], [[T::ZERO; 3]; N]);
        for begin in (0..count).step_by(N) {
            let end = (begin + N).min(count);
            let mut sums = [[[T::ZERO; 4]; N]; 2];
            for k in 0..N {
                let at = (begin + k).min(count - 1) * SLOT;
                centres[k] = [self.bins[at], self.bins[at + 1], self.bins[at + 2]];
            }
            for &slot in slots {
                let facet = Facet::read(self.facets, slot);
                for k in 0..N {
                    cosines[k] = dot(facet.normal, centres[k]);
                }
                if self.class.has_bins() {
                    let sign = |k: usize| if cosines[k] > T::ZERO { T::ONE } else { -T::ONE };
                    taps.set(
                        &self.layout,
                        #[inline(always)]
                        |k| facet.in_frame(times(sign(k), centres[k])),
                    );
                }
                let radiance = &self.radiance[slot as usize * SLOT..][..3];
                let radiance = [radiance[0], radiance[1], radiance[2], T::ZERO];
                let [specular, antiradiance] =
                    [(self.class.glossy, self.specular), (self.class.blocker, self.antiradiance)].map(
                        |(has, bins)| {
                            has.then(|| {
                                &bins[(slot - self.first) as usize * count * channels..][..count * channels]
                            })
                        },
                    );
                for k in 0..end - begin {
                    let seen = cosines[k].magnitude() * facet.area;
                    let [up, down] = if cosines[k] > T::ZERO { [0, 1] } else { [1, 0] };
                    add(&mut sums[up][k], seen, radiance);
                    if let Some(specular) = specular {
                        add(&mut sums[up][k], seen, taps.gather(k, &self.layout, specular));
                    }
                    if let Some(antiradiance) = antiradiance {
                        add(&mut sums[down][k], -seen, taps.gather(k, &self.layout, antiradiance));
                    }
                }
            }
            for (k, bin) in (begin..end).enumerate() {
                for c in 0..channels {
                    above[bin * channels + c] += factor * sums[0][k][c];
                    below[bin * channels + c] += -factor * sums[1][k][c];
                }
            }
        }
    }
}
