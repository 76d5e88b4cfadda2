mod support;
use antirad::image::{Picture, Rasterizer};
use antirad::shading::Light;
use support::{device, finish, load, solve};

#[test]
fn picture() {
    let device = device();
    let scene = load("scenes/cornell_boxes.toml");
    let (mut engine, solution) = solve(&device, &scene, &scene.settings);
    let truth = Picture::read_exr("/work/shared/reference/cornell_boxes.exr").unwrap();
    for camera in &scene.cameras {
        println!("{} {}x{} truth {}x{}", camera.name, camera.width, camera.height, truth.width, truth.height);
        let colours = engine.face_colours(&solution, camera.position).unwrap();
        let coverage = Rasterizer::new(&device).unwrap().coverage(&scene, camera, 4).unwrap();
        let flat = coverage.pixels(&colours).unwrap();
        let t = std::time::Instant::now();
        let light = Light::new(&engine, &solution, &scene);
        let gathered = light.pixels(&scene, camera, &coverage, &colours).unwrap();
        println!("{:?}", t.elapsed());
        for (name, pixels) in [("flat", flat), ("gathered", gathered)] {
            let mut sum = 0.0;
            let mut map = Vec::new();
            for (p, t) in pixels.iter().zip(&truth.pixels) {
                let e: f64 = (0..3).map(|c| { let r = f64::from(t[c]); (p[c] - r).powi(2) / (r * r + 0.01) }).sum();
                sum += e / 3.0;
                map.push([e as f32, e as f32, e as f32, 1.0]);
            }
            println!("{name}: relMSE {:.3e}", sum / pixels.len() as f64);
            let mut order: Vec<usize> = (0..map.len()).collect();
            order.sort_by(|a, b| map[*b][0].total_cmp(&map[*a][0]));
            println!("{:?}", order[..12].iter().map(|&i| (i % 256, i / 256, map[i][0], pixels[i], truth.pixels[i])).collect::<Vec<_>>());
            let total: f32 = map.iter().map(|m| m[0]).sum();
            let top: f32 = order[..655].iter().map(|&i| map[i][0]).sum();
            println!("share of the worst percent {}", top / total);
            let p = Picture { width: truth.width, height: truth.height, pixels: map.iter().map(|m| [m[0].sqrt(); 4]).collect() };
            p.write_png(format!("/tmp/{name}_error.png"), &Default::default()).unwrap();
            let p = Picture { width: truth.width, height: truth.height, pixels: pixels.iter().map(|m| m.map(|v| v as f32)).collect() };
            p.write_png(format!("/tmp/{name}.png"), &Default::default()).unwrap();
        }
    }
    finish(&device);
}
