//! `antirad compare`: the errors of a fitted scene, or of a picture.

use crate::Failure;
use crate::compare_pictures;
use antirad::scene::{LoadOptions, Material, Scene};
use clap::Args;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

#[derive(Args)]
#[command(after_help = "Examples:
  antirad compare scenes/cornell_boxes.toml out/fits/cornell/scene.toml
  antirad compare out/traced/cornell_boxes/main.exr out/cornell_boxes/main.exr")]
pub struct Arguments {
    /// The true scene, or the true picture in EXR
    #[arg(value_name = "TRUTH")]
    truth: PathBuf,
    /// The fitted scene, which has the same triangles: scene.toml of a fit; or the other picture in EXR
    #[arg(value_name = "FITTED")]
    fitted: PathBuf,
}

/// A number or a colour of a material.
struct Quantity {
    name: &'static str,
    of: fn(&Material) -> Vec<f64>,
}

const QUANTITIES: [Quantity; 5] = [
    Quantity { name: "emission", of: |m| m.emission.to_vec() },
    Quantity { name: "albedo", of: |m| m.albedo.to_vec() },
    Quantity { name: "diffuse", of: |m| vec![m.diffuse] },
    Quantity { name: "specular", of: |m| m.specular.to_vec() },
    Quantity { name: "power", of: |m| vec![m.power] },
];

/// Maximum number of rows printed per quantity.
const ROWS: usize = 12;

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let is_picture = |path: &Path| path.extension().is_some_and(|extension| extension == "exr");
    if [&arguments.truth, &arguments.fitted].iter().all(|path| is_picture(path)) {
        return compare_pictures::run(&arguments.truth, &arguments.fitted);
    }
    let load = |path: &Path| Scene::load(path, &LoadOptions::default());
    let (truth, fitted) = (load(&arguments.truth)?, load(&arguments.fitted)?);
    let counts = |scene: &Scene| (scene.triangles.len(), scene.vertices.len());
    if counts(&truth) != counts(&fitted) {
        let message = format!(
            "{} and {} cannot be compared: they have {} and {} triangles, {} and {} vertices",
            arguments.truth.display(),
            arguments.fitted.display(),
            counts(&truth).0,
            counts(&fitted).0,
            counts(&truth).1,
            counts(&fitted).1,
        );
        return Err(Failure::Error(message.into()));
    }
    row(["", "true", "found", "largest error of a channel"]);
    for quantity in &QUANTITIES {
        print(quantity, &differences(&truth, &fitted, quantity));
    }
    if !differences(&truth, &fitted, &QUANTITIES[0]).is_empty() {
        let share = format!("{:.3} %", 100.0 * power_where_true(&truth, &fitted));
        row(["power on true lamps", "100 %", &share, ""]);
    }
    let distances = truth.vertices.iter().zip(&fitted.vertices).map(|(a, b)| a.distance(*b));
    let farthest = distances.fold(0.0, f64::max);
    if farthest > 0.0 {
        row(["vertices", "", "", &format!("{farthest:.2e} m")]);
    }
    Ok(())
}

fn row([what, truth, found, error]: [&str; 4]) {
    antirad::say!("{}", format!("{what:<22} {truth:<24} {found:<24} {error}").trim_end());
}

/// True and found values where they differ, by the fitted scene's materials.
type Differences = BTreeMap<String, (Vec<f64>, Vec<f64>)>;

fn differences(truth: &Scene, fitted: &Scene, quantity: &Quantity) -> Differences {
    let materials = (0..truth.triangles.len()).map(|t| (truth.material(t), fitted.material(t)));
    let values = materials.map(|(a, b)| (b.name.clone(), ((quantity.of)(a), (quantity.of)(b))));
    values.filter(|(_, (truth, found))| truth != found).collect()
}

fn print(quantity: &Quantity, differences: &Differences) {
    let error = |(truth, found): &(Vec<f64>, Vec<f64>)| {
        truth.iter().zip(found).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    if differences.len() > ROWS {
        let worst = differences.values().map(error).fold(0.0, f64::max);
        let mean = differences.values().map(error).sum::<f64>() / differences.len() as f64;
        let found = format!("in {} materials", differences.len());
        row([quantity.name, "", &found, &format!("{worst:.2e}, {mean:.2e} on average")]);
        return;
    }
    for (name, values) in differences {
        let (truth, found) = values;
        let relative = truth.iter().zip(found).map(|(a, b)| (b / a - 1.0).abs()).fold(0.0, f64::max);
        let relative =
            if relative.is_finite() { format!(", {:.3} %", 100.0 * relative) } else { String::new() };
        let what = format!("{} of {name}", quantity.name);
        row([&what, &numbers(truth), &numbers(found), &format!("{:.2e}{relative}", error(values))]);
    }
}

fn numbers(values: &[f64]) -> String {
    values.iter().map(|v| format!("{v:.4}")).collect::<Vec<_>>().join(" ")
}

/// Fraction of the fitted scene's emitted power that comes from triangles which emit in the true scene.
fn power_where_true(truth: &Scene, fitted: &Scene) -> f64 {
    let power = |t: usize| fitted.area_vector(t).length() * fitted.material(t).emission.iter().sum::<f64>();
    let all = 0..truth.triangles.len();
    let shines = |t: &usize| truth.material(*t).emission.iter().any(|e| *e > 0.0);
    all.clone().filter(shines).map(power).sum::<f64>() / all.map(power).sum::<f64>()
}
