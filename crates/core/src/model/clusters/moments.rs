//! Sums over the triangles of a cluster, and where the tree is cut.

use super::ClusterInput;
use crate::model::facet::{Facet, orthonormal_basis};
use crate::model::facet_gradient::FacetGradient;
use crate::model::order::PADDING;
use glam::{DMat3, DVec3};
use std::iter::Sum;
use std::ops::{Add, Range};

/// Sums weighted by area.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    pub area: f64,
    /// Σ a².
    squares: f64,
    /// Σ a x.
    centre: DVec3,
    /// Σ a |x|².
    distance: f64,
    /// Σ a n.
    normal: DVec3,
    /// Σ a R, R being the frame of a triangle.
    frame: [DVec3; 3],
    /// Σ a brightness, and with x.
    pub brightness: f64,
    bright_centre: DVec3,
}

impl Moments {
    pub fn of(facet: &Facet, brightness: f64) -> Self {
        let &Facet { centroid, normal, area, .. } = facet;
        let frame = orthonormal_basis(normal);
        Self {
            area,
            squares: area * area,
            centre: area * centroid,
            distance: area * centroid.length_squared(),
            normal: area * normal,
            frame: [frame.x_axis, frame.y_axis, frame.z_axis].map(|axis| area * axis),
            brightness: area * brightness,
            bright_centre: area * brightness * centroid,
        }
    }

    /// The mean triangle, with the variance of the centroids in place of the characteristic area.
    pub fn facet(&self) -> Facet {
        if self.area == 0.0 {
            return Facet::new([DVec3::ZERO; 3]);
        }
        let centroid = self.centre / self.area;
        Facet {
            corners: [centroid; 3],
            centroid,
            normal: super::mean_normal(self.normal),
            area: self.squares / self.area,
            characteristic_area: self.spread(),
        }
    }

    pub fn centroid(&self) -> DVec3 {
        self.centre / self.area
    }

    /// Variance of the centroids.
    pub fn spread(&self) -> f64 {
        (self.distance / self.area - (self.centre / self.area).length_squared()).max(0.0)
    }

    /// Distance of the centroid of the light from that of the cluster.
    pub fn offset(&self) -> f64 {
        (self.bright_centre / self.brightness).distance(self.centre / self.area)
    }

    /// Mean square of the angle between the frames of the triangles and that of the cluster: |R - R'|² is twice it.
    pub fn turn(&self) -> f64 {
        let own: DMat3 = orthonormal_basis(super::mean_normal(self.normal));
        let [x, y, z] = self.frame;
        let along = x.dot(own.x_axis) + y.dot(own.y_axis) + z.dot(own.z_axis);
        (3.0 - along / self.area).max(0.0)
    }

    /// The length of the vector area: that of the cluster seen along its normal.
    pub fn vector_area(&self) -> f64 {
        self.normal.length()
    }
}

/// Sums as derivatives: each field holds the derivative by that field.
impl Moments {
    /// The derivative by the sums of a cluster, from that by its mean triangle ([`Self::facet`]): with c = Σ a x / Σ a,
    /// ā = Σ a² / Σ a, σ² = Σ a |x|² / Σ a - |c|² and n along Σ a n_i.
    pub fn pull(&self, mean: &FacetGradient) -> Self {
        let own = self.facet();
        let by_centre: DVec3 = mean.corners.iter().sum();
        let by_centre = by_centre - 2.0 * mean.characteristic_area * own.centroid;
        let by_area = by_centre.dot(own.centroid)
            + mean.area * own.area
            + mean.characteristic_area * self.distance / self.area;
        let length = self.normal.length();
        let across = mean.normal - own.normal * own.normal.dot(mean.normal);
        Self {
            area: -by_area / self.area,
            squares: mean.area / self.area,
            centre: by_centre / self.area,
            distance: mean.characteristic_area / self.area,
            normal: if length > 0.0 { across / length } else { DVec3::ZERO },
            ..Self::default()
        }
    }

    /// Adds the derivative by one triangle of the cluster; `self` holds the derivative by the sums.
    pub fn pull_triangle(&self, facet: &Facet, gradient: &mut FacetGradient) {
        let &Facet { centroid, normal, area, .. } = facet;
        gradient.area += self.area
            + 2.0 * area * self.squares
            + self.centre.dot(centroid)
            + self.distance * centroid.length_squared()
            + self.normal.dot(normal);
        gradient.add_centroid(area * (self.centre + 2.0 * self.distance * centroid));
        gradient.normal += area * self.normal;
    }
}

impl Add for Moments {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let [x, y, z] = self.frame;
        let [u, v, w] = other.frame;
        Self {
            area: self.area + other.area,
            squares: self.squares + other.squares,
            centre: self.centre + other.centre,
            distance: self.distance + other.distance,
            normal: self.normal + other.normal,
            frame: [x + u, y + v, z + w],
            brightness: self.brightness + other.brightness,
            bright_centre: self.bright_centre + other.bright_centre,
        }
    }
}

impl Sum for Moments {
    fn sum<I: Iterator<Item = Self>>(parts: I) -> Self {
        parts.fold(Self::default(), Add::add)
    }
}

/// Sums over the leaves before each leaf: their number of triangles, and of points (x, n) and their squares.
struct Before {
    count: f64,
    position: DVec3,
    normal: DVec3,
    squares: f64,
}

/// Cuts ranges of leaves where positions and normals then vary least in both branches, groups first.
pub struct Cuts {
    before: Vec<Before>,
    /// The group of each leaf.
    pub groups: Vec<u32>,
}

/// Smallest share of its leaves in a branch, which bounds the height of the tree.
const LEAST_SHARE: usize = 8;

impl Cuts {
    pub fn new(input: &ClusterInput) -> Self {
        let mut sum = Before { count: 0.0, position: DVec3::ZERO, normal: DVec3::ZERO, squares: 0.0 };
        let (mut before, mut groups) = (Vec::new(), Vec::new());
        for (first, slots) in (0..).step_by(input.leaf as usize).zip(input.order.chunks(input.leaf as usize))
        {
            before.push(Before { ..sum });
            groups.push(input.groups.partition_point(|&begin| begin <= first) as u32 - 1);
            for &i in slots.iter().filter(|&&i| i != PADDING) {
                let Facet { centroid, normal, .. } = input.facets[i as usize];
                sum.count += 1.0;
                sum.position += centroid;
                sum.normal += normal;
                sum.squares += centroid.length_squared() + 1.0;
            }
        }
        before.push(sum);
        Self { before, groups }
    }

    /// Sum of squared distances from the mean.
    fn variance(&self, leaves: Range<usize>) -> f64 {
        let (from, to) = (&self.before[leaves.start], &self.before[leaves.end]);
        let count = (to.count - from.count).max(1.0);
        let mean =
            (to.position - from.position).length_squared() + (to.normal - from.normal).length_squared();
        to.squares - from.squares - mean / count
    }

    pub fn cut(&self, leaves: &Range<usize>) -> usize {
        let group = self.groups[leaves.start];
        let other = |at: &usize| self.groups[*at] != group;
        if let Some(at) = Some(leaves.end - 1).filter(other).and_then(|_| leaves.clone().find(other)) {
            return at;
        }
        let least = (leaves.len() / LEAST_SHARE).max(1);
        let cost = |at: usize| self.variance(leaves.start..at) + self.variance(at..leaves.end);
        let cuts = (leaves.start + least..=leaves.end - least).map(|at| (cost(at), at));
        cuts.min_by(|(a, _), (b, _)| a.total_cmp(b)).map_or(leaves.start + 1, |(_, at)| at)
    }
}
