//! Direct light of lamps against path tracing.
mod support;
use antirad::direct::{DirectLight, lamps};
use antirad::model::Facet;
use antirad::scene::{LoadOptions, Scene};
use std::path::Path;

#[test]
fn cornell() {
    let scene = Scene::load(Path::new("scenes/cornell_boxes.toml"), &LoadOptions::default()).unwrap();
    let facets: Vec<Facet> = (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect();
    let t = std::time::Instant::now();
    let lamps = lamps(&scene, &facets, 1e-6);
    println!("{} lamps {:?}", lamps.len(), lamps[0]);
    let light = DirectLight::new(&facets, lamps);
    println!("{:?}", t.elapsed());
    let bytes = std::fs::read("tests/data/cornell_boxes.direct_irradiance.npy").unwrap();
    let truth: Vec<f32> = npyz::NpyFile::new(&bytes[..]).unwrap().into_vec().unwrap();
    let (mut e, mut n) = (0.0, 0.0);
    let mut worst = (0.0, 0, 0.0, 0.0);
    for i in 0..facets.len() {
        for c in 0..3 {
            let h: f64 = light
                .lamps()
                .iter()
                .enumerate()
                .map(|(l, lamp)| light.factors(i)[l] * scene.material(lamp.triangles[0] as usize).emission[c])
                .sum();
            let t = f64::from(truth[3 * i + c]);
            let d = (h - t).powi(2) * facets[i].area;
            if d > worst.0 {
                worst = (d, i, h, t);
            }
            e += d;
            n += t * t * facets[i].area;
        }
    }
    println!("error {} worst {worst:?}", (e / n).sqrt());
}
