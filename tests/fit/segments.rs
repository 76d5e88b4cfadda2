//! Materials told apart by segmentation pictures alone.

use super::says;
use super::scenes::{near, watch};
use crate::support::{backend, finish};
use antirad::fit::{EngineRenderer, JobFile, Renderer, RunOptions};
use antirad::image::Picture;
use antirad::render::Quantity;
use antirad::scene::{Camera, Material, Mesh, Scene, SceneBuilder, Shape};
use antirad_render::image::View;
use glam::{DAffine3, DQuat, DVec3};
use image::{Rgb, RgbImage};
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;
use std::ops::ControlFlow;
use std::path::Path;
use tempfile::TempDir;

/// Colour, albedo and turn of each wall.
const WALLS: [([u8; 3], [f64; 3], DVec3); 3] = [
    ([255, 0, 0], [0.7, 0.5, 0.3], DVec3::ZERO),
    ([0, 255, 0], [0.2, 0.4, 0.6], DVec3::new(FRAC_PI_2, 0.0, 0.0)),
    ([1, 2, 3], [0.5, 0.45, 0.4], DVec3::new(0.0, 0.0, -FRAC_PI_2)),
];
const SIZE: [u32; 2] = [48, 36];

/// A floor and two walls, each of a material of its own, under a lamp.
fn truth() -> Scene {
    let mut builder = SceneBuilder::new();
    for (name, (_, albedo, turn)) in ["floor", "back", "side"].into_iter().zip(WALLS) {
        let material = Material { albedo, ..Material::named(name) };
        let place = DAffine3::from_quat(DQuat::from_scaled_axis(turn))
            * DAffine3::from_translation(DVec3::splat(-0.5));
        builder.shape(name, Shape::Quad { cells: 3 }, &material, place);
    }
    let lamp = Material { emission: [8.0; 3], albedo: [0.0; 3], ..Material::named("lamp") };
    let over = DAffine3::from_scale_rotation_translation(
        DVec3::splat(0.3),
        DQuat::from_rotation_x(2.0 * FRAC_PI_2),
        DVec3::new(0.0, 0.6, 0.2),
    );
    builder.shape("lamp", Shape::Quad { cells: 1 }, &lamp, over);
    let mut scene = builder.finish("room").expect("a scene");
    scene.cameras = [("a", [0.6, 0.5, 1.2]), ("b", [0.9, 0.2, 0.8])].map(camera).to_vec();
    scene
}

fn camera((name, position): (&str, [f64; 3])) -> Camera {
    let (position, target) = (position.into(), DVec3::new(-0.1, -0.2, -0.1));
    let [width, height] = SIZE;
    Camera { name: name.into(), position, target, up: DVec3::Y, fov_x_degrees: 60.0, width, height }
}

/// A folder with pictures of the truth, what each pixel shows, and the scene as one mesh of one material beside the lamp.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let (backend, scene) = (backend(), truth());
    let renderer = EngineRenderer::new(&backend, scene.clone(), 4, Default::default(), watch());
    let pictures = renderer.expect("a renderer").pictures(&scene).expect("pictures");
    let mut frames = Vec::new();
    for (camera, pixels) in scene.cameras.iter().zip(pictures) {
        let name = &camera.name;
        let pixels = pixels.iter().map(|p| [p.x as f32, p.y as f32, p.z as f32, 1.0]).collect();
        let picture = Picture { width: camera.width, height: camera.height, pixels };
        picture.write_exr(folder.path().join(format!("{name}.exr"))).expect("written");
        labels(&scene, camera).save(folder.path().join(format!("seg_{name}.png"))).expect("written");
        let view = View::new(camera);
        let rows = (0..3).map(|k| {
            let [right, up, forward] = [view.right, view.up, view.forward].map(|axis| axis[k]);
            format!("[{right}, {up}, {}, {}]", -forward, camera.position[k])
        });
        let rows = rows.collect::<Vec<_>>().join(", ");
        frames
            .push(format!("{{\"file_path\": \"{name}.exr\", \"transform_matrix\": [{rows}, [0, 0, 0, 1]]}}"));
    }
    let mut set = String::new();
    let angle = 60.0_f64.to_radians();
    write!(set, "{{\"camera_angle_x\": {angle}, \"frames\": [{}]}}", frames.join(", ")).expect("a string");
    std::fs::write(folder.path().join("t.json"), set).expect("written");
    one_mesh(scene).save(&folder.path().join("s.toml")).expect("written");
    finish(&backend);
    folder
}

/// What the centre of each pixel shows, by colour.
fn labels(scene: &Scene, camera: &Camera) -> RgbImage {
    let (rays, view) = (scene.rays(), View::new(camera));
    RgbImage::from_fn(camera.width, camera.height, |x, y| {
        let ray = view.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let wall = rays
            .nearest(camera.position, ray, None)
            .and_then(|(t, _)| scene.meshes.iter().position(|mesh| mesh.range.contains(&(t as u32))));
        Rgb(wall.and_then(|wall| WALLS.get(wall)).map_or([0; 3], |(colour, ..)| *colour))
    })
}

/// The walls as one mesh of one material.
fn one_mesh(mut scene: Scene) -> Scene {
    let [.., back, lamp] = &scene.meshes[..] else { unreachable!("four meshes") };
    let walls = Mesh { name: "walls".into(), range: 0..back.range.end };
    scene.meshes = vec![walls.clone(), lamp.clone()];
    for t in walls.range {
        scene.triangles[t as usize].material = scene.triangles[0].material;
    }
    scene
}

fn load(folder: &Path, target: &str, fit: &str) -> Result<JobFile, String> {
    let job = format!(
        "scene = \"s.toml\"\n[[target]]\ncameras = \"t.json\"\n{target}\n[[fit]]\nmeshes = [\"walls\"]\n{fit}\n\
         [[regulariser]]\nkind = \"prior\"\nof = \"albedo\"\nweight = 1e-12\n[solve]\ntolerance = 1e-6\n"
    );
    std::fs::write(folder.join("j.toml"), job).expect("written");
    JobFile::load(&folder.join("j.toml")).map_err(|error| error.to_string())
}

const SEGMENTS: &str = "segments = \"seg_{name}.png\"";
const ALBEDO: &str = "parameter = \"albedo\"\nper = \"segment\"\ninitial = 0.35";

#[test]
fn each_segment_of_a_mesh_has_an_albedo() {
    let folder = folder();
    let mut job = load(folder.path(), SEGMENTS, ALBEDO).expect("a job").job;
    let names: Vec<&str> =
        job.problem().parameters.groups_of(Quantity::Albedo).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["#00ff00", "#010203", "#ff0000"]);
    let backend = backend();
    let parameters = &job.problem().parameters;
    let (planning, request) = (parameters.planning_scene(), parameters.gradient_request());
    let mut renderer = EngineRenderer::new(&backend, planning, 4, request, watch()).expect("a renderer");
    let options = RunOptions::default();
    let outcome = job.run(&mut renderer, &options, &mut |_, _| ControlFlow::Continue(()));
    let outcome = outcome.expect("an outcome");
    for (name, (_, albedo, _)) in ["#ff0000", "#00ff00", "#010203"].into_iter().zip(WALLS) {
        near(&outcome, "albedo", name, &albedo, 0.01);
    }
    drop(renderer);
    finish(&backend);
}

#[test]
fn what_segments_are_for_and_what_is_wrong_with_them() {
    let folder = folder();
    let at = folder.path();
    let refused = |target: &str, fit: &str, parts: &[&str]| {
        let error = load(at, target, fit).err().unwrap_or_else(|| panic!("{target} {fit} is taken"));
        says(&error, parts);
    };
    refused("", ALBEDO, &["j.toml:5", "per = \"segment\"", "segments = \"seg/{name}.png\""]);
    refused("segments = \"s/{name}.png\"", ALBEDO, &["j.toml:3", "frame \"a\"", "s/a.png", "cannot be read"]);
    refused("segments = \"a.exr\"", ALBEDO, &["frame \"a\"", "a.exr", "floats", "PNG"]);
    RgbImage::new(24, 18).save(at.join("small.png")).expect("written");
    refused("segments = \"small.png\"", ALBEDO, &["frame \"a\"", "small.png", "24 x 18", "48 x 36"]);
    RgbImage::from_fn(48, 36, |x, y| Rgb([x as u8, y as u8, 0])).save(at.join("many.png")).expect("written");
    refused("segments = \"many.png\"", ALBEDO, &["frame \"a\"", "many.png", "1728 colours", "256 labels"]);
    let emission = "parameter = \"emission\"\nper = \"segment\"\ndetect = true";
    refused(SEGMENTS, emission, &["j.toml:5", "`per` and `detect`"]);
    // One value for each of three segments, of other quantities, too.
    let lobes = "parameter = \"specular\"\nper = \"segment\"\n[[fit]]\nmeshes = [\"walls\"]\nparameter = \"power\"\nper = \"segment\"";
    let job =
        load(at, SEGMENTS, &format!("{ALBEDO}\n[[fit]]\nmeshes = [\"walls\"]\n{lobes}")).expect("a job").job;
    assert_eq!(job.problem().parameters.len(), 3 * (3 + 3 + 1));
    // What a job of photographs fits if it does not say.
    let job = format!("scene = \"s.toml\"\n[[target]]\ncameras = \"t.json\"\n{SEGMENTS}\n");
    std::fs::write(at.join("j.toml"), job).expect("written");
    let file = JobFile::load(&at.join("j.toml")).expect("a job");
    assert_eq!(file.job.problem().parameters.groups_of(Quantity::Albedo).len(), 4);
    says(&file.warnings.join("\n"), &["each segment of other meshes has one albedo"]);
    // A picture alone has no frames.
    let job = "scene = \"s.toml\"\n[[target]]\npicture = \"a.exr\"\nsegments = \"s.png\"\n[[fit]]\nparameter = \"albedo\"\n";
    std::fs::write(at.join("j.toml"), job).expect("written");
    let error = JobFile::load(&at.join("j.toml")).err().expect("no set").to_string();
    says(&error, &["j.toml:4", "`segments` is for sets"]);
}
