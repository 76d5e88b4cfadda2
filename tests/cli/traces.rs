//! `antirad trace` and what it writes.

use crate::{Folder, says};
use antirad::image::Picture;

const FILES: [&str; 4] = ["main.error.exr", "main.exr", "main.png", "report.json"];

fn picture(folder: &Folder, name: &str) -> Picture {
    Picture::read_exr(folder.path(name)).expect("an EXR picture")
}

#[test]
fn a_trace_leaves_pictures_and_their_noise() {
    let folder = Folder::with(&[]);
    let run = folder.run("trace room.toml --camera main --samples 16 --output out").succeeded();
    assert_eq!((folder.results(), run.stderr.as_str()), (FILES.map(String::from).to_vec(), ""));
    says(&run.stdout, &["main: noise", "main.error.exr"]);

    let (found, error) = (picture(&folder, "out/main.exr"), picture(&folder, "out/main.error.exr"));
    assert_eq!((found.width, found.height, error.width, error.height), (32, 24, 32, 24));
    // From within a closed room every pixel shows some light, more red than blue.
    assert!(found.pixels.iter().all(|[r, g, b, _]| r >= g && g >= b && *b > 0.0));
    let squares = |picture: &Picture| -> f64 {
        picture.pixels.iter().flat_map(|[r, g, b, _]| [r, g, b]).map(|&x| f64::from(x).powi(2)).sum()
    };
    let noise = (squares(&error) / squares(&found)).sqrt();
    let report = folder.json("out/report.json");
    let told = report["pictures"][0]["noise"].as_f64().expect("a number");
    assert!((told / noise - 1.0).abs() <= 1e-5 && (0.005..=0.2).contains(&noise), "{told}, {noise}");
    assert_eq!((&report["samples"], &report["seed"]), (&16.into(), &0.into()));

    // The solve's picture is the same up to noise and the error of a mesh of 16 faces a wall.
    folder.run("render room.toml --camera main --quiet --output solved").succeeded();
    let solved = picture(&folder, "solved/main.exr");
    let mean = |picture: &Picture| picture.pixels.iter().map(|p| f64::from(p[0])).sum::<f64>();
    let total = |picture: &Picture| -> f64 {
        picture.pixels.iter().flat_map(|[r, g, b, _]| [r, g, b]).map(|&x| f64::from(x)).sum()
    };
    assert!((mean(&found) / mean(&solved) - 1.0).abs() <= 0.1, "{} {}", mean(&found), mean(&solved));
    let compared = folder.run("compare out/main.exr solved/main.exr").succeeded().stdout;
    let bias = format!("{:+.3} %", 100.0 * (total(&solved) / total(&found) - 1.0));
    says(&compared, &["difference", &format!("noise of the first     {:.3} %", 100.0 * noise), &bias]);
    assert!(!compared.contains("of the second"), "{compared}");
}

#[test]
fn the_same_seed_gives_the_same_bytes_in_any_number_of_threads() {
    let folder = Folder::with(&[]);
    let trace = |out: &str, seed: &str, threads: &str| {
        let arguments = ["trace", "room.toml", "--samples", "4", "--seed", seed, "--quiet", "--output", out];
        crate::run(folder.tool(arguments).env("RAYON_NUM_THREADS", threads)).succeeded();
        ["main.exr", "main.png", "main.error.exr", "side.exr"]
            .map(|file| folder.read(&format!("{out}/{file}")))
    };
    let first = trace("a", "7", "1");
    assert_eq!(trace("b", "7", "3"), first);
    assert_ne!(trace("c", "8", "3"), first);
}

#[test]
fn what_cannot_be_traced_is_refused() {
    let folder = Folder::with(&[]);
    folder.run("trace room.toml --camera back --output out").refused(&["\"back\"", "main, side"]);
    folder.run("trace nowhere.toml --output out").refused(&["nowhere.toml", "cannot be read"]);
    let run = folder.run("trace room.toml --samples 1 --output out");
    assert_eq!(run.code, Some(2), "{run:?}");
    says(&run.stderr, &["--samples", "2.."]);
    assert!(folder.results().is_empty());
}

#[test]
fn pictures_that_cannot_be_compared() {
    let folder = Folder::with(&[]);
    folder.run("trace room.toml --samples 2 --quiet --output out").succeeded();
    let wrong = ["32 x 24", "16 x 16"];
    folder.run("compare out/main.exr out/side.exr").refused(&wrong);
    folder.run("compare out/main.exr out/nowhere.exr").refused(&["nowhere.exr"]);
    let mut picture = picture(&folder, "out/main.exr");
    picture.pixels[35][1] = f32::NAN;
    picture.write_exr(folder.path("nan.exr")).expect("a file");
    folder.run("compare out/main.exr nan.exr").refused(&["nan.exr", "pixel 3, 1", "not finite"]);
    picture.pixels.fill([0.0; 4]);
    picture.write_exr(folder.path("black.exr")).expect("a file");
    folder.run("compare black.exr out/main.exr").refused(&["black.exr is black"]);
}
