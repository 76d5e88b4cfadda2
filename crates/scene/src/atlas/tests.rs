use super::*;
use crate::{Material, Scene, SceneBuilder, Shape, Triangle};
use glam::{DAffine3, DVec3};

fn of_shape(shape: Shape) -> Scene {
    let mut builder = SceneBuilder::new();
    let place = DAffine3::from_rotation_y(0.3) * DAffine3::from_scale(DVec3::new(2.0, 1.0, 0.5));
    builder.shape("it", shape, &Material::named("grey"), place);
    builder.finish("s").expect("a scene")
}

fn all(scene: &Scene) -> Vec<u32> {
    (0..scene.triangles.len() as u32).collect()
}

/// The chart of each triangle, by the texel around its centroid, after all that an atlas promises was checked by points of triangles.
fn check(scene: &Scene, size: [u32; 2], distortion: f64) -> Vec<u32> {
    let atlas = scene.atlas(&all(scene), size).unwrap_or_else(|crowded| panic!("{crowded}"));
    let again = scene.atlas(&all(scene), size).expect("an atlas");
    assert_eq!((&atlas.uvs, &atlas.chart_of), (&again.uvs, &again.chart_of));
    let texels = DVec2::from(size.map(f64::from));
    let mut densities = Vec::new();
    let mut chart = Vec::new();
    for (t, uvs) in atlas.uvs.iter().enumerate() {
        assert!(uvs.iter().all(|uv| uv.cmpge(DVec2::ZERO).all() && uv.cmple(DVec2::ONE).all()), "{uvs:?}");
        if scene.area_vector(t).length() == 0.0 {
            chart.push(NO_CHART);
            continue;
        }
        densities.push(area(uvs.map(|uv| uv * texels)) / scene.area_vector(t).length());
        // What look-ups at points of the triangle read belongs to one chart.
        let mut read = Vec::new();
        for i in 0..=12 {
            for j in 0..=12 - i {
                let [u, v] = [i, j].map(|k| f64::from(k) / 12.0);
                let uv = uvs[0] + (uvs[1] - uvs[0]) * u + (uvs[2] - uvs[0]) * v;
                let weights = crate::texture::weights(size, uv);
                read.extend(weights.into_iter().filter(|(_, weight)| *weight > 1e-4).map(|(texel, _)| texel));
            }
        }
        let own = atlas.chart_of[read[0] as usize];
        assert!(own != NO_CHART && read.iter().all(|&texel| atlas.chart_of[texel as usize] == own), "{t}");
        chart.push(own);
    }
    let largest = densities.iter().copied().fold(0.0, f64::max);
    let off = densities.iter().find(|density| density.is_nan() || **density < distortion * largest);
    assert!(off.is_none(), "{off:?} of {largest} texels per square metre");
    // No triangle lies over another.
    let corners: Vec<[DVec2; 3]> = atlas.uvs.iter().map(|uvs| uvs.map(|uv| uv * texels)).collect();
    for (a, first) in corners.iter().enumerate() {
        for (b, second) in corners[..a].iter().enumerate() {
            assert!(!overlap(first, second, 1e-3), "{a} over {b}");
        }
    }
    chart
}

#[test]
fn a_box_has_a_chart_for_each_side() {
    let scene = of_shape(Shape::Box { cells: 3 });
    let mut charts = check(&scene, [64, 64], 0.999);
    charts.sort_unstable();
    charts.dedup();
    assert_eq!(charts.len(), 6);
}

/// Half of the texture and more is used.
#[test]
fn charts_are_as_large_as_they_can_be() {
    for shape in [Shape::Box { cells: 1 }, Shape::Icosphere { level: 2, inward: false }] {
        let scene = of_shape(shape);
        let atlas = scene.atlas(&all(&scene), [128, 128]).expect("an atlas");
        let used: f64 = atlas.uvs.iter().map(|uvs| area(*uvs)).sum();
        assert!((0.5..1.0).contains(&used), "{used}");
    }
}

#[test]
fn curved_surfaces_are_cut_where_they_would_be_distorted() {
    let sphere = of_shape(Shape::Icosphere { level: 2, inward: false });
    check(&sphere, [64, 64], charts::FACING - 1e-9);
    check(&sphere, [128, 48], charts::FACING - 1e-9);
    let statue = of_shape(Shape::Statue { triangles: 1000 });
    let charts = check(&statue, [128, 128], charts::FACING - 1e-9);
    assert!(charts.iter().all(|chart| *chart < 100), "{charts:?}");
}

/// A ramp that winds twice around an axis, and faces up all the way.
#[test]
fn a_surface_that_winds_over_itself_is_cut() {
    let mut vertices = Vec::new();
    for k in 0..=48 {
        let (angle, height) = (f64::from(k) * std::f64::consts::PI / 12.0, f64::from(k) * 0.05);
        vertices.extend([1.0, 2.0].map(|r| DVec3::new(r * angle.cos(), height, -r * angle.sin())));
    }
    let triangles = (0..48).flat_map(|k| [[0, 1, 3], [0, 3, 2]].map(|abc| abc.map(|v| v + 2 * k)));
    let triangles = triangles.map(|vertices| Triangle { vertices, material: 0 }).collect();
    let scene = Scene::new("s", vertices, triangles, vec![Material::named("grey")]).expect("a scene");
    check(&scene, [64, 64], charts::FACING - 1e-9);
}

/// Sheets whose triangles share nothing, and triangles without area.
#[test]
fn loose_triangles_fit_or_are_refused() {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for k in 0..300 {
        let at = DVec3::new(f64::from(k % 20), 0.0, f64::from(k / 20));
        let first = vertices.len() as u32;
        let third = if k % 30 == 0 { DVec3::Z * 0.8 } else { DVec3::X * 0.4 };
        vertices.extend([at, at + DVec3::Z * 0.4, at + third]);
        triangles.push(Triangle { vertices: [first, first + 1, first + 2], material: 0 });
    }
    let scene = Scene::new("s", vertices, triangles, vec![Material::named("grey")]).expect("a scene");
    check(&scene, [64, 64], 0.999);
    let crowded = scene.atlas(&all(&scene), [32, 32]).expect_err("no room");
    assert_eq!((crowded.charts, crowded.size, crowded.enough()), (290, [32, 32], 64));
    assert!(
        scene.atlas(&[0, 30], [1, 1]).is_ok_and(|atlas| atlas
            .uvs
            .iter()
            .flatten()
            .all(|uv| *uv == DVec2::splat(0.5)))
    );
}
