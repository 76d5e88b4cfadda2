//! Texture coordinates for triangles that have none: charts of the surface, side by side in one texture.

mod charts;
mod packing;

use std::fmt;

use glam::DVec2;

use super::Scene;
use charts::{Chart, charts, overlap};
use packing::pack;

/// Steps in which the scale of charts is found.
const STEPS: u32 = 20;
/// Of a texel: what rounding may move a corner by.
const ROUNDING: f64 = 1e-6;

/// Texture coordinates by which no two triangles lie over each other, at one scale for all, and no texel belongs to two charts, also
/// where look-ups are linear between texels.
#[derive(Clone, Debug)]
pub(super) struct Atlas {
    /// Of the corners of each triangle. Triangles without area have a point of no chart.
    pub uvs: Vec<[DVec2; 3]>,
    /// Row by row from the top, the chart of each texel that a look-up in it reads; [`NO_CHART`] for others.
    pub chart_of: Vec<u32>,
}

/// In place of the number of a chart.
pub(super) const NO_CHART: u32 = u32::MAX;

/// A surface has more charts than a texture has room for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crowded {
    /// How many charts there are.
    pub charts: usize,
    /// Columns and rows of the texture.
    pub size: [u32; 2],
}

impl fmt::Display for Crowded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { charts, size: [columns, rows] } = self;
        write!(
            f,
            "the charts that it is cut into ({charts}) are too many for a texture of {columns} x {rows} texels"
        )
    }
}

impl Crowded {
    /// Columns and rows of a square texture that has room.
    pub fn enough(&self) -> u32 {
        least(self.charts)
    }
}

/// Columns and rows, a power of two, of the smallest texture for so many charts: the smallest ones take two texels by two.
fn least(charts: usize) -> u32 {
    (2 * (charts as f64).sqrt().ceil() as u32).next_power_of_two()
}

impl Scene {
    /// Columns and rows, a power of two, of the smallest texture that has room for an atlas of triangles, with a point or two for each
    /// chart.
    #[doc(hidden)]
    pub fn least_atlas(&self, triangles: &[u32]) -> u32 {
        least(charts(self, triangles).len())
    }

    /// An atlas for triangles, for a texture of such columns and rows.
    pub(super) fn atlas(&self, triangles: &[u32], size: [u32; 2]) -> Result<Atlas, Crowded> {
        let charts = charts(self, triangles);
        let texels = |chart: &Chart, scale: f64| {
            (chart.size * scale + ROUNDING).ceil().to_array().map(|texels| texels as u32 + 1)
        };
        let places = |scale: f64| {
            let sizes: Vec<[u32; 2]> = charts.iter().map(|chart| texels(chart, scale)).collect();
            pack(&sizes, size)
        };
        let columns_and_rows = DVec2::from(size.map(f64::from));
        let area = |chart: &Chart| chart.triangles.iter().map(|(_, abc)| area(*abc)).sum::<f64>();
        let surface: f64 = charts.iter().map(area).sum();
        let mut best = (0.0, places(0.0).ok_or(Crowded { charts: charts.len(), size })?);
        let (mut low, mut high) = (0.0, (columns_and_rows.element_product() / surface).sqrt());
        for _ in 0..STEPS {
            let scale = f64::midpoint(low, high);
            match places(scale) {
                Some(places) => (low, best) = (scale, (scale, places)),
                None => high = scale,
            }
        }
        let (scale, places) = best;
        let mut uvs = vec![[DVec2::splat(0.5) / columns_and_rows; 3]; triangles.len()];
        let mut chart_of = vec![NO_CHART; size[0] as usize * size[1] as usize];
        for ((number, chart), place) in (0..).zip(&charts).zip(places) {
            let origin = DVec2::from(place.map(f64::from)) + 0.5;
            for &(k, corners) in &chart.triangles {
                let corners = corners.map(|corner| origin + scale * corner);
                uvs[k] = corners.map(|corner| corner / columns_and_rows);
                read_texels(&corners, size, |texel| chart_of[texel] = number);
            }
        }
        Ok(Atlas { uvs, chart_of })
    }
}

fn area([a, b, c]: [DVec2; 3]) -> f64 {
    (b - a).perp_dot(c - a).abs() / 2.0
}

/// The texels that look-ups within a triangle read, by its corners in texels: those whose centres are less than one texel off in both
/// coordinates.
fn read_texels(corners: &[DVec2; 3], [columns, rows]: [u32; 2], mut take: impl FnMut(usize)) {
    let low = corners.iter().fold(DVec2::INFINITY, |low, p| low.min(*p)) - 1.5;
    let high = corners.iter().fold(DVec2::NEG_INFINITY, |high, p| high.max(*p)) + 0.5;
    let range = |k: usize, count: u32| {
        low[k].ceil().max(0.0) as u32..(high[k].floor() + 1.0).min(f64::from(count)) as u32
    };
    for row in range(1, rows) {
        for column in range(0, columns) {
            let centre = DVec2::new(f64::from(column), f64::from(row)) + 0.5;
            let square = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
                .map(|corner| centre + DVec2::from(corner));
            if overlap(corners, &square, ROUNDING) {
                take(row as usize * columns as usize + column as usize);
            }
        }
    }
}

#[cfg(test)]
mod tests;
