//! How light varies over a mesh, from values per triangle: what the error estimates and the choice of triangles to cut read.

use antirad_scene::{Scene, Welded, sides};
use glam::DVec3;
use std::collections::HashMap;

/// Neighbours whose normals have a cosine above this are coplanar.
const COPLANAR: f64 = 0.999;

/// What continues a triangle across one of its sides: one coplanar triangle, or several where the side has further vertices.
type Across = Vec<u32>;

/// Areas and coplanar neighbours of triangles.
pub(super) struct Surface {
    /// Area, m²; zero of what only emits: what falls on a lamp or the sky changes nothing.
    pub weights: Vec<f64>,
    /// Of each triangle, the neighbours across its sides, where there are some.
    neighbours: Vec<Vec<Across>>,
    areas: Vec<f64>,
    centroids: Vec<DVec3>,
    /// Mean square of the distance from the centroid over each triangle, m².
    spreads: Vec<f64>,
    /// Index per triangle.
    materials: Vec<u32>,
}

impl Surface {
    pub fn new(scene: &Scene) -> Self {
        let count = scene.triangles.len();
        let vectors: Vec<DVec3> = (0..count).map(|i| scene.area_vector(i)).collect();
        let areas: Vec<f64> = vectors.iter().map(|v| v.length()).collect();
        let counts = |i: &usize| !scene.material(*i).only_emits();
        let weights = (0..count).map(|i| if counts(&i) { areas[i] } else { 0.0 }).collect();
        let is_coplanar = |i: u32, j: u32| {
            let [i, j] = [i as usize, j as usize];
            vectors[i].dot(vectors[j]) > COPLANAR * areas[i] * areas[j]
        };
        let centroid = |i| scene.corners(i).iter().sum::<DVec3>() / 3.0;
        let spread = |i| {
            let [a, b, c] = scene.corners(i);
            (a.distance_squared(b) + b.distance_squared(c) + c.distance_squared(a)) / 36.0
        };
        Self {
            weights,
            neighbours: neighbours(scene, &is_coplanar),
            areas,
            centroids: (0..count).map(centroid).collect(),
            spreads: (0..count).map(spread).collect(),
            materials: scene.triangles.iter().map(|t| t.material).collect(),
        }
    }

    /// An estimate of the difference between the mean of light over a triangle and the value at its centroid. For E with a curvature κ, the
    /// former is κ/2 times the mean square of the distance from the centroid. What neighbours interpolate linearly at the centroid differs
    /// from the value there by κ/2 times the mean square of their distances, with the weights of the interpolation: of equilateral triangles
    /// four times as much.
    pub fn off_neighbours(&self, values: &[DVec3], triangle: usize) -> DVec3 {
        let [a, b, c] = self.neighbours[triangle].as_slice() else {
            // At a border a slope would look like curvature.
            return DVec3::ZERO;
        };
        let own = self.centroids[triangle];
        let [places, means] =
            [&self.centroids, values].map(|of| [a, b, c].map(|across| self.mean(of, across)));
        let Some(weights) = barycentric(places, own) else { return DVec3::ZERO };
        let of = |k: usize| weights[k] * places[k].distance_squared(own);
        let distances = of(0) + of(1) + of(2);
        let off: DVec3 = (0..3).map(|k| weights[k] * means[k]).sum::<DVec3>() - values[triangle];
        if distances > self.spreads[triangle] {
            off * (self.spreads[triangle] / distances)
        } else {
            DVec3::ZERO
        }
    }

    /// Estimates the standard deviation of light within a triangle from the differences to its neighbours. For a slope g on
    /// equilateral triangles of side s, the variance is g²s²/24, a quarter of the mean squared difference, since centroids are
    /// s/√3 apart in three directions. Along a shadow edge a quarter gives 1/8 of the squared step where 1/6 is true. We take a
    /// third, which is right there and overestimates the deviation of a slope by a sixth.
    pub fn within(&self, values: &[DVec3], triangle: usize) -> DVec3 {
        let of_one_material = |&&j: &&u32| self.materials[j as usize] == self.materials[triangle];
        let (mut squares, mut count) = (DVec3::ZERO, 0.0);
        for across in &self.neighbours[triangle] {
            for &j in across.iter().filter(of_one_material) {
                let difference = values[j as usize] - values[triangle];
                let share = 1.0 / across.len() as f64;
                squares += share * difference * difference;
                count += share;
            }
        }
        if count > 0.0 { (squares / (3.0 * count)).map(f64::sqrt) } else { DVec3::ZERO }
    }

    /// Area-weighted.
    fn mean(&self, values: &[DVec3], triangles: &[u32]) -> DVec3 {
        let of = |f: &dyn Fn(usize) -> DVec3| triangles.iter().map(|&i| f(i as usize)).sum::<DVec3>();
        let area: f64 = triangles.iter().map(|&i| self.areas[i as usize]).sum();
        of(&|i| self.areas[i] * values[i]) / area.max(f64::MIN_POSITIVE)
    }
}

/// Barycentric coordinates of a place in the plane of a triangle, if that has an area.
fn barycentric([a, b, c]: [DVec3; 3], place: DVec3) -> Option<[f64; 3]> {
    let normal = (b - a).cross(c - a);
    let all = normal.length_squared();
    let of = |u: DVec3, v: DVec3| (u - place).cross(v - place).dot(normal) / all;
    (all > 0.0).then(|| [of(b, c), of(c, a), of(a, b)])
}

/// Coplanar triangles across the sides of each triangle: several where the side was cut at its middle, and halves at theirs, on the other
/// side of it alone.
fn neighbours(scene: &Scene, is_coplanar: &dyn Fn(u32, u32) -> bool) -> Vec<Vec<Across>> {
    let welded = Welded::exactly(scene.vertices.iter().copied());
    let place = |position: u32| scene.vertices[welded.first[position as usize] as usize];
    let bits = |place: DVec3| (place + DVec3::ZERO).to_array().map(f64::to_bits);
    let at: HashMap<[u64; 3], u32> = (0..welded.first.len() as u32).map(|p| (bits(place(p)), p)).collect();
    let corners: Vec<[u32; 3]> = scene.triangles.iter().map(|t| welded.positions(t.vertices)).collect();
    // Of each directed side the triangle that runs along it, if it is the only one.
    let mut of_side: HashMap<[u32; 2], Option<u32>> = HashMap::new();
    for (t, corners) in (0..).zip(&corners) {
        for side in sides(*corners) {
            of_side.entry(side).and_modify(|of| *of = None).or_insert(Some(t));
        }
    }
    let across = |t: u32, [a, b]: [u32; 2]| {
        let mut found = Vec::new();
        let mut open = vec![[a, b]];
        while let Some([a, b]) = open.pop() {
            match of_side.get(&[b, a]) {
                Some(Some(other)) if is_coplanar(t, *other) => found.push(*other),
                Some(_) => return Vec::new(),
                None => match at.get(&bits(place(a).midpoint(place(b)))) {
                    Some(&middle) if middle != a && middle != b => open.extend([[middle, b], [a, middle]]),
                    _ => return Vec::new(),
                },
            }
        }
        found
    };
    let mut neighbours = vec![Vec::new(); corners.len()];
    for (t, corners) in (0..).zip(&corners) {
        for side in sides(*corners) {
            let found = across(t, side);
            if let [_, _, ..] = found.as_slice() {
                // They find nothing across their sides.
                found.iter().for_each(|&part| neighbours[part as usize].push(vec![t]));
            }
            neighbours[t as usize].extend((!found.is_empty()).then_some(found));
        }
    }
    neighbours
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::{Material, SceneBuilder, Shape};
    use glam::DAffine3;

    fn square(cells: u32) -> Scene {
        let mut builder = SceneBuilder::new();
        builder.shape("square", Shape::Quad { cells }, &Material::named("grey"), DAffine3::IDENTITY);
        builder.finish("scene").expect("a scene")
    }

    /// Means of a function of x over triangles, by the midpoints of their sides: exact for polynomials of degree 2.
    fn means(scene: &Scene, of: impl Fn(f64) -> f64) -> Vec<DVec3> {
        let mean = |i: usize| {
            let [a, b, c] = scene.corners(i).map(|corner| corner.x);
            (of(0.5 * (a + b)) + of(0.5 * (b + c)) + of(0.5 * (c + a))) / 3.0
        };
        (0..scene.triangles.len()).map(|i| DVec3::new(mean(i), 0.0, 0.0)).collect()
    }

    fn norm(surface: &Surface, of: impl Fn(usize) -> DVec3) -> f64 {
        (0..surface.areas.len()).map(|i| surface.areas[i] * of(i).length_squared()).sum::<f64>().sqrt()
    }

    /// E = x² over a square of n x n cells: the mean over a triangle with legs h differs from the value at its centroid by
    /// h²/18.
    #[test]
    fn neighbours_estimate_the_mean_over_a_triangle() {
        for cells in [8, 32] {
            let scene = square(cells);
            let (surface, values) = (Surface::new(&scene), means(&scene, |x| x * x));
            let exact = (1.0 / f64::from(cells)).powi(2) / 18.0;
            let found = norm(&surface, |i| surface.off_neighbours(&values, i));
            println!("{cells} cells: {found:.2e}, exact {exact:.2e}");
            assert!(found / exact >= 0.5 && found / exact <= 2.0, "{found} {exact}");
        }
    }

    /// Where triangles of several sizes meet, a slope is no curvature.
    #[test]
    fn slopes_are_told_from_curvature_beside_finer_triangles() {
        let mut scene = square(6);
        for fourth in [4, 2] {
            let chosen: Vec<u32> = (0..scene.triangles.len() as u32).filter(|t| t % fourth == 1).collect();
            scene.split(&chosen);
        }
        let surface = Surface::new(&scene);
        let inner = surface.neighbours.iter().filter(|of| of.len() == 3).count();
        assert!(2 * inner > scene.triangles.len(), "{inner} of {}", scene.triangles.len());
        let several = surface.neighbours.iter().flatten().filter(|across| across.len() > 1).count();
        assert!(several > 20, "{several}");
        let slope = means(&scene, |x| x);
        let found = norm(&surface, |i| surface.off_neighbours(&slope, i));
        assert!(found <= 1e-12, "{found}");
    }

    /// E = x: the mean squared deviation within a right triangle with legs h is h²/18, a quarter of the mean squared difference.
    #[test]
    fn neighbours_estimate_the_variation_within_a_triangle() {
        for cells in [8, 32] {
            let scene = square(cells);
            let (surface, values) = (Surface::new(&scene), means(&scene, |x| x));
            let slope = norm(&surface, |i| surface.within(&values, i));
            let exact = 1.0 / (f64::from(cells) * 18f64.sqrt());
            let expected = exact * (4.0f64 / 3.0).sqrt();
            println!("{cells} cells, slope: {slope:.2e}, exact {exact:.2e}");
            // Up to the border, where neighbours are missing.
            assert!((slope / expected - 1.0).abs() <= 0.5 / f64::from(cells), "{slope} {expected}");
        }
    }

    /// A step of albedo is not a variation within a triangle.
    #[test]
    fn material_borders_are_not_shadows() {
        let mut scene = square(2);
        scene.materials = ["black", "white"].map(Material::named).to_vec();
        for (i, triangle) in scene.triangles.iter_mut().enumerate() {
            triangle.material = i as u32 % 2;
        }
        let surface = Surface::new(&scene);
        let values: Vec<DVec3> = (0..scene.triangles.len()).map(|i| DVec3::splat((i % 2) as f64)).collect();
        assert!((0..values.len()).all(|i| surface.within(&values, i) == DVec3::ZERO));
    }
}
