//! The bins of clusters, gathered from their parts, and their cotangents, passed on to these. Twin of glsl/gather_bins.comp and
//! scatter_bins.comp.

use super::on_threads;
use super::pairs::{Facet, dot};
use super::real::Real;
use crate::gpu::{BufferSlice, Device, GpuError};
use crate::model::{ClusterRun, Clusters, Parts};
use crate::plan::Plan;
use crate::scene::Precision;
use rayon::prelude::*;
use std::ops::Range;

/// The bins of the clusters of a group, or cotangents of these.
pub struct ClusterBins<'a> {
    pub clusters: &'a Clusters,
    pub run: &'a ClusterRun,
    pub facets: BufferSlice<'a>,
    pub own: BufferSlice<'a>,
}

/// What is done with them. The bins of triangles begin with a slot.
#[derive(Clone, Copy)]
pub enum Step<'a> {
    /// Those of some clusters, by height, are set from those of triangles, or of others.
    Gather(BufferSlice<'a>, u32, &'a [Vec<Range<u32>>]),
    /// What comes from the clusters that they are part of is added to those of clusters.
    Within,
    /// The same to those of triangles, from some clusters of these.
    ToTriangles(BufferSlice<'a>, u32, &'a Range<u32>),
}

/// Numbers of the bins of each, and the index with which they begin.
#[derive(Clone, Copy)]
struct Page {
    reals: usize,
    first: u32,
}

impl Page {
    fn at(self, index: u32) -> Range<usize> {
        let begin = (index - self.first) as usize * self.reals;
        begin..begin + self.reals
    }
}

impl ClusterBins<'_> {
    /// Takes a step. `None` where kernels must do it.
    pub fn step(&self, device: &Device, plan: &Plan, step: Step) -> Result<Option<()>, GpuError> {
        match plan.settings.precision {
            Precision::F32 => self.step_as::<f32>(device, plan, step),
            Precision::F64 => self.step_as::<f64>(device, plan, step),
        }
    }

    fn step_as<T: Real>(&self, device: &Device, plan: &Plan, step: Step) -> Result<Option<()>, GpuError> {
        match step {
            Step::Gather(triangles, first, of) => self.gather::<T>(device, plan, (triangles, first), of),
            Step::Within => self.within::<T>(device, plan),
            Step::ToTriangles(triangles, first, of) => {
                self.to_triangles::<T>(device, plan, (triangles, first), of)
            }
        }
    }

    fn page(&self, plan: &Plan) -> Page {
        Page { reals: plan.bins.count() * plan.channels as usize, first: self.run.range().start }
    }

    fn parts(&self, cluster: u32) -> &Parts {
        &self.clusters.parts()[(cluster - self.clusters.first()) as usize]
    }

    fn gather<T: Real>(
        &self,
        device: &Device,
        plan: &Plan,
        (triangles, first): (BufferSlice, u32),
        heights: &[Vec<Range<u32>>],
    ) -> Result<Option<()>, GpuError> {
        let page = self.page(plan);
        let of_triangles = Page { first, ..page };
        device.edit_on_host([self.own], [self.facets, triangles], |[own], [facets, triangles]| {
            for of in heights.iter().flatten() {
                // Parts come before what they make up.
                let (before, own) = own.split_at_mut(page.at(of.start).start);
                let own = &mut own[..of.len() * page.reals];
                let gathered = |(own, cluster): (&mut [T], u32)| {
                    own.fill(T::ZERO);
                    for part in self.parts(cluster).indices() {
                        let from = match self.parts(cluster) {
                            Parts::Triangles(_) => &triangles[of_triangles.at(part)],
                            Parts::Clusters(_) => &before[page.at(part)],
                        };
                        add(share(facets, part, cluster), from, own);
                    }
                };
                on_threads(|| own.par_chunks_mut(page.reals).zip(of.clone()).for_each(gathered));
            }
        })
    }

    fn within<T: Real>(&self, device: &Device, plan: &Plan) -> Result<Option<()>, GpuError> {
        let page = self.page(plan);
        device.edit_on_host([self.own], [self.facets], |[own]: [&mut [T]; 1], [facets]| {
            for of in self.run.heights.iter().skip(1).rev() {
                let (before, own) = own.split_at_mut(page.at(of.start).start);
                let from = Page { first: of.start, ..page };
                self.scatter(facets, of, (own, from), (before, page));
            }
        })
    }

    fn to_triangles<T: Real>(
        &self,
        device: &Device,
        plan: &Plan,
        (triangles, first): (BufferSlice, u32),
        of: &Range<u32>,
    ) -> Result<Option<()>, GpuError> {
        let page = self.page(plan);
        device.edit_on_host(
            [triangles],
            [self.facets, self.own],
            |[triangles]: [&mut [T]; 1], [facets, own]| {
                self.scatter(facets, of, (own, page), (triangles, Page { first, ..page }));
            },
        )
    }

    /// From some clusters to their parts.
    fn scatter<T: Real>(
        &self,
        facets: &[T],
        of: &Range<u32>,
        (from, from_page): (&[T], Page),
        (to, to_page): (&mut [T], Page),
    ) {
        let of_cluster = |cluster: u32| self.parts(cluster).indices().map(move |part| (part, cluster));
        let mut parts: Vec<(u32, u32)> = of.clone().flat_map(of_cluster).collect();
        parts.sort_unstable();
        // No part belongs to two clusters.
        let mut own = Vec::with_capacity(parts.len());
        let (mut rest, mut at) = (to, 0);
        for &(part, cluster) in &parts {
            let Range { start, end } = to_page.at(part);
            let (this, behind) = rest.split_at_mut(end - at);
            own.push((&mut this[start - at..], part, cluster));
            (rest, at) = (behind, end);
        }
        on_threads(|| {
            own.into_par_iter().for_each(|(to, part, cluster)| {
                add(share(facets, part, cluster), &from[from_page.at(cluster)], to);
            });
        });
    }
}

/// The weight of a part's radiance in that of its cluster: [`crate::model::share`].
fn share<T: Real>(facets: &[T], part: u32, cluster: u32) -> T {
    let [part, cluster] = [part, cluster].map(|index| Facet::read(facets, index));
    let share = part.area * dot(part.normal, cluster.normal) / cluster.area;
    if cluster.area > T::ZERO { share } else { T::ZERO }
}

fn add<T: Real>(factor: T, from: &[T], to: &mut [T]) {
    for (to, &from) in to.iter_mut().zip(from) {
        *to += factor * from;
    }
}
