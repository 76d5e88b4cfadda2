//! The two backends: who chooses between them, and what they find.

use crate::fits::{JOB, folder};
use crate::{Folder, ROOM, run, says, without_driver};
use npyz::NpyFile;
use serde_json::Value;
use std::fs;
use std::path::Path;

fn flat(folder: &Folder, name: &str) -> Vec<f64> {
    let values: Vec<f32> = NpyFile::new(&folder.read(name)[..]).expect("npy").into_vec().expect("f32");
    values.into_iter().map(f64::from).collect()
}

fn relative(found: &[f64], truth: &[f64]) -> f64 {
    assert_eq!(found.len(), truth.len());
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    norm(&mut found.iter().zip(truth).map(|(a, b)| a - b)) / norm(&mut truth.iter().copied())
}

/// The report of a render, without a variable that would choose for it.
fn rendered(folder: &Folder, arguments: &str) -> Value {
    let arguments = format!("render {arguments} --refine=never --quiet --supersample 1 --output out");
    run(folder.tool(arguments.split_whitespace()).env_remove("ANTIRAD_BACKEND")).succeeded();
    folder.json("out/report.json")
}

#[test]
fn renders_agree_and_name_their_backend() {
    let folder = Folder::with(&[]);
    let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cornell_boxes.toml");
    let [cpu, vulkan] = ["cpu", "vulkan"].map(|backend| {
        let render =
            format!("render {scene} --backend {backend} --refine=never --supersample 1 --output {backend}");
        let said = folder.run(&render).succeeded().stdout;
        says(&said, &[&format!("backend     {backend} on "), " threads"]);
        let report = folder.json(&format!("{backend}/report.json"));
        assert_eq!(report["backend"], backend);
        assert!(report["threads"].as_u64() > Some(0));
        says(&said, &[report["device"]["name"].as_str().expect("a name")]);
        let arrays = ["irradiance", "radiosity"].map(|name| flat(&folder, &format!("{backend}/{name}.npy")));
        (report, arrays)
    });
    assert!(cpu.0["device"]["vulkan"].is_null() && vulkan.0["device"]["vulkan"].is_string());
    assert_ne!(cpu.0["device"]["driver"], vulkan.0["device"]["driver"]);
    for (name, (cpu, vulkan)) in ["irradiance", "radiosity"].iter().zip(cpu.1.iter().zip(&vulkan.1)) {
        let off = relative(cpu, vulkan);
        println!("{name}: {off:.1e}");
        assert!(off <= 1e-3, "{name}: {off}");
    }
}

/// A fit takes the same way on both, but for rounding.
#[test]
fn fits_agree() {
    let folder = folder(&[("job.toml", &JOB.replace("iterations = 12", "iterations = 3"))]);
    let [cpu, vulkan] = ["cpu", "vulkan"].map(|backend| {
        folder.run(&format!("fit job.toml --backend {backend} --output {backend}")).succeeded();
        assert_eq!(folder.json(&format!("{backend}/job/report.json"))["run"]["backend"], backend);
        let found = folder.json(&format!("{backend}/job/parameters.json"));
        let values =
            found.as_array().expect("a list").iter().flat_map(|one| one["value"].as_array().cloned());
        values.flatten().map(|value| value.as_f64().expect("a number")).collect::<Vec<f64>>()
    });
    assert!(cpu.len() >= 6, "{cpu:?}");
    let off = relative(&cpu, &vulkan);
    assert!(off <= 1e-3, "{cpu:?} and {vulkan:?}");
}

/// Without a GPU the CPU computes; a driver is then not needed at all.
#[test]
fn without_a_driver_the_cpu_computes() {
    let folder = Folder::with(&[]);
    let mut tool = folder.tool(["render", "room.toml", "--refine=never", "--quiet", "--output", "out"]);
    tool.env_remove("ANTIRAD_BACKEND").env_remove("ANTIRAD_DEVICE");
    run(without_driver(&mut tool, Path::new("/nowhere.json"))).succeeded();
    assert_eq!(folder.json("out/report.json")["backend"], "cpu");
}

/// The command line decides, then the scene, then the environment.
#[test]
fn scenes_name_a_backend() {
    let of_scene = |backend: &str| format!("{ROOM}[settings]\nbackend = \"{backend}\"\n");
    let (vulkan, auto) = (of_scene("vulkan"), of_scene("auto"));
    let folder = Folder::with(&[("vulkan.toml", &vulkan), ("auto.toml", &auto)]);
    assert_eq!(rendered(&folder, "vulkan.toml")["backend"], "vulkan");
    assert_eq!(rendered(&folder, "vulkan.toml --backend cpu")["backend"], "cpu");
    for (scene, variable, expected) in [
        ("room.toml", "vulkan", "vulkan"),
        ("auto.toml", "vulkan", "vulkan"),
        ("room.toml", "cpu", "cpu"),
        ("vulkan.toml", "cpu", "vulkan"),
    ] {
        let mut tool = folder.tool([
            "render",
            scene,
            "--refine=never",
            "--quiet",
            "--supersample",
            "1",
            "--output",
            "out",
        ]);
        run(tool.env("ANTIRAD_BACKEND", variable)).succeeded();
        assert_eq!(folder.json("out/report.json")["backend"], expected, "{scene}, {variable}");
    }
    let unknown = of_scene("gpu");
    fs::write(folder.path("gpu.toml"), &unknown).expect("written");
    let line = unknown.lines().position(|line| line.starts_with("backend")).expect("the key") + 1;
    let place = format!("gpu.toml:{line}");
    folder.render("gpu.toml").refused(&[&place, "\"gpu\" is no backend", "auto, vulkan or cpu"]);
}

/// A job's backend is that of its table `[solve]`, otherwise that of its scene.
#[test]
fn jobs_name_a_backend() {
    let job = JOB.replace("iterations = 12", "iterations = 1");
    let of_job = format!("{job}[solve]\nbackend = \"vulkan\"\n");
    let folder = folder(&[("job.toml", &of_job), ("plain.toml", &job)]);
    let backend = |job: &str, arguments: &str| {
        let arguments = format!("fit {job}.toml --restart --output fits {arguments}");
        run(folder.tool(arguments.split_whitespace()).env_remove("ANTIRAD_BACKEND")).succeeded();
        folder.json(&format!("fits/{job}/report.json"))["run"]["backend"].clone()
    };
    assert_eq!(backend("job", ""), "vulkan");
    assert_eq!(backend("job", "--backend cpu"), "cpu");
    assert_eq!(backend("plain", "--backend vulkan"), "vulkan");
    let scene = String::from_utf8(folder.read("room.toml")).expect("text");
    fs::write(folder.path("room.toml"), scene.replace("tolerance", "backend = \"vulkan\"\ntolerance"))
        .expect("written");
    assert_eq!(backend("plain", ""), "vulkan");

    let unknown = of_job.replace("vulkan", "gpu");
    fs::write(folder.path("job.toml"), &unknown).expect("written");
    let refused = folder.run("fit job.toml --restart --output fits");
    assert_eq!(refused.code, Some(1), "{refused:?}");
    let line = unknown.lines().position(|line| line.starts_with("backend")).expect("the key") + 1;
    says(&refused.stderr, &[&format!("job.toml:{line}"), "\"gpu\" is no backend", "auto, vulkan or cpu"]);
}
