//! The mesh at which the search starts.

use crate::scene::{Scene, bounds};

/// Longest edge that is not cut, as a share of the scene's diagonal. A wall needs several triangles: only the differences
/// between neighbours show how light varies within them.
const WIDEST: f64 = 0.22;

/// Of the box around all that does not only emit, as a sky does: m.
fn diagonal(scene: &Scene) -> f64 {
    let lit = (0..scene.triangles.len()).filter(|&i| !scene.material(i).only_emits());
    let (low, high) = bounds(lit.flat_map(|i| scene.corners(i)));
    low.distance(high)
}

/// Cuts triangles with edges longer than [`WIDEST`] until there are none, or `max_triangles` would be exceeded. Returns the
/// index of the original triangle of each triangle.
pub(super) fn cut_wide(scene: &mut Scene, max_triangles: usize) -> Vec<u32> {
    let diagonal = diagonal(scene);
    let mut parents: Vec<u32> = (0..scene.triangles.len() as u32).collect();
    loop {
        let longest = |t: u32| {
            let [a, b, c] = scene.corners(t as usize);
            a.distance(b).max(b.distance(c)).max(c.distance(a))
        };
        let wide: Vec<u32> = (0..parents.len() as u32)
            .filter(|&t| longest(t) > WIDEST * diagonal && !scene.material(t as usize).only_emits())
            .collect();
        if wide.is_empty() || parents.len() + 3 * wide.len() > max_triangles {
            return parents;
        }
        parents = scene.split(&wide).into_iter().map(|parent| parents[parent as usize]).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Material, SceneBuilder, Shape};
    use glam::{DAffine3, DVec3};

    #[test]
    fn wide_triangles_are_cut_and_others_stay() {
        let mut builder = SceneBuilder::new();
        builder.shape("room", Shape::Room { cells: 1 }, &Material::named("grey"), DAffine3::IDENTITY);
        let small = DAffine3::from_scale(DVec3::splat(0.1));
        builder.shape("box", Shape::Box { cells: 1 }, &Material::named("grey"), small);
        let given = builder.finish("scene").expect("a scene");

        let mut scene = given.clone();
        let parents = cut_wide(&mut scene, usize::MAX);
        // Edges of √2 become √2/4, within .22 √3.
        assert_eq!(scene.triangles.len(), 12 * 16 + 12);
        let pieces = |t: u32| parents.iter().filter(|&&parent| parent == t).count();
        assert!((0..12).all(|t| pieces(t) == 16) && (12..24).all(|t| pieces(t) == 1));

        let mut bounded = given.clone();
        assert_eq!(cut_wide(&mut bounded, 100).len(), 12 * 4 + 12);
    }
}
