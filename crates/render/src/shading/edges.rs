//! Edges of the shadows of suns in pictures: they are so sharp that a pixel needs more than one point.

use super::sights::{Sight, on_plane};
use crate::image::FaceInPixel;
use antirad_core::direct::barycentric;

/// Difference of the shares of a sun that are seen from neighbouring pixels, from which an edge passes there: penumbras less than 16 pixels
/// wide.
const EDGE: f64 = 1.0 / 16.0;
/// Parts along each side of a pixel there, fewer where faces are glossy, since each has rays.
const PARTS: u32 = 8;
const GLOSSY_PARTS: u32 = 4;
/// Share of a pixel that may show nothing, and cosine between normals of one plane.
const EMPTY: f64 = 1e-9;
const COPLANAR: f64 = 1.0 - 1e-9;

/// What is seen, with parts in place of what pixels show that edges pass, where that is a single plane. `seen`: in the order of pixels, in
/// rows of `width`; `sunlit`: of each, the share of each sun, if the face is turned towards it.
pub fn cut(
    sight: &Sight,
    seen: &[FaceInPixel],
    sunlit: &[Vec<Option<f64>>],
    width: usize,
    is_glossy: impl Fn(usize) -> bool,
) -> Vec<FaceInPixel> {
    let differ = |a: usize, b: usize| {
        let pairs = sunlit[a].iter().zip(&sunlit[b]);
        pairs.filter_map(|(a, b)| Some((*a)? - (*b)?)).any(|difference| difference.abs() > EDGE)
    };
    let of_pixel = |pixel: usize| {
        let from = seen.partition_point(|other| other.pixel < pixel);
        (from..seen.len()).take_while(move |&k| seen[k].pixel == pixel)
    };
    let at_edge = |k: usize| {
        let (column, row) = (seen[k].pixel % width, seen[k].pixel / width);
        let columns = column.saturating_sub(1)..=(column + 1).min(width - 1);
        let mut around = (row.saturating_sub(1)..=row + 1)
            .flat_map(|row| columns.clone().map(move |column| row * width + column));
        around.any(|pixel| of_pixel(pixel).any(|other| differ(k, other)))
    };
    let mut all = Vec::with_capacity(seen.len());
    let mut first = 0;
    for faces in seen.chunk_by(|a, b| a.pixel == b.pixel) {
        if (first..first + faces.len()).any(at_edge) && is_one_plane(sight, faces) {
            let count = if faces.iter().any(|seen| is_glossy(seen.face)) { GLOSSY_PARTS } else { PARTS };
            parts(sight, faces, width, count, &mut all);
        } else {
            all.extend(faces);
        }
        first += faces.len();
    }
    all
}

/// Whether a pixel shows nothing but faces of one plane.
fn is_one_plane(sight: &Sight, faces: &[FaceInPixel]) -> bool {
    let plane = &sight.facets[faces[0].face];
    let in_plane = |seen: &FaceInPixel| {
        let facet = &sight.facets[seen.face];
        let apart = facet.centroid - plane.centroid;
        facet.normal.dot(plane.normal) > COPLANAR
            && apart.dot(plane.normal).abs() <= (1.0 - COPLANAR) * (apart.length() + 1.0)
    };
    faces.iter().map(|seen| seen.share).sum::<f64>() > 1.0 - EMPTY && faces.iter().all(in_plane)
}

/// Appends the parts of a pixel, each of the face that it lies in. Those of a face share what the pixel shows of it.
fn parts(sight: &Sight, faces: &[FaceInPixel], width: usize, count: u32, to: &mut Vec<FaceInPixel>) {
    let along = |k: u32| (f64::from(k) + 0.5) / f64::from(count);
    let corner = [(faces[0].pixel % width) as f64, (faces[0].pixel / width) as f64];
    let mut places = vec![Vec::new(); faces.len()];
    for [x, y] in (0..count).flat_map(|row| (0..count).map(move |column| [along(column), along(row)])) {
        let place = [corner[0] + x, corner[1] + y];
        let within = |seen: &FaceInPixel| {
            let facet = &sight.facets[seen.face];
            let point = on_plane(facet, sight.eye, sight.view.ray(place[0], place[1]));
            barycentric(facet.corners, facet.normal, point).min_element()
        };
        let depths: Vec<f64> = faces.iter().map(within).collect();
        let face = (0..faces.len()).max_by(|a, b| depths[*a].total_cmp(&depths[*b]));
        places[face.unwrap_or(0)].push(place);
    }
    for (seen, places) in faces.iter().zip(places) {
        match places.len() {
            0 => to.push(*seen),
            all => to.extend(places.iter().map(|&place| FaceInPixel {
                share: seen.share / all as f64,
                place,
                ..*seen
            })),
        }
    }
}
