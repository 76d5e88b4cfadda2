//! Objects: triangles that hang together by shared corners.

use super::facet::Facet;
use glam::DVec3;

/// Per facet, the first facet of the object that it belongs to. Facets hang together where corners are at the
/// same place.
pub fn objects(facets: &[Facet]) -> Vec<u32> {
    // Adding zero turns -0 into +0.
    let place = |x: DVec3| (x + DVec3::ZERO).to_array().map(f64::to_bits);
    let corners = facets.iter().zip(0..).flat_map(|(facet, i)| facet.corners.map(|x| (place(x), i)));
    let mut corners: Vec<([u64; 3], u32)> = corners.collect();
    corners.sort_unstable();
    let mut first: Vec<u32> = (0..facets.len() as u32).collect();
    for pair in corners.windows(2) {
        let [(here, a), (there, b)] = [pair[0], pair[1]];
        if here == there {
            let (a, b) = (root(&mut first, a), root(&mut first, b));
            first[a.max(b) as usize] = a.min(b);
        }
    }
    (0..facets.len() as u32).map(|i| root(&mut first, i)).collect()
}

/// The first facet of those known to hang together with one, with the way there halved.
fn root(first: &mut [u32], mut i: u32) -> u32 {
    while first[i as usize] != i {
        first[i as usize] = first[first[i as usize] as usize];
        i = first[i as usize];
    }
    i
}
