//! The readers of files, fed with bytes: by cargo-fuzz, and by a test on stable Rust.

use antirad::fit::JobFile;
use antirad::scene::{LoadOptions, Scene};
use tempfile::TempDir;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(dead_code, reason = "a fuzz target uses one of them")]
pub enum Reader {
    Obj,
    Mtl,
    Scene,
    Job,
    Gltf,
    Ply,
    Mitsuba,
}

const OBJ: &str =
    "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl lamp\nf 1 2 3\nusemtl white\nf 1 3 4\n";
const MTL: &str = "newmtl white\nKd .5 .5 .5\nnewmtl lamp\nKd .5 .5 .5\nKe 1 1 1\n";
const SCENE: &str = "[[mesh]]\npath = \"m.obj\"\n[camera.main]\nposition = [0, 0, 5]\ntarget = [0, 0, 0]\n\
                     fov_x_degrees = 40\nwidth = 4\nheight = 4\n";
/// A black PNG of 4 x 4 pixels, the picture that jobs fit to.
const PNG: &[u8] = include_bytes!("black.png");

/// More bytes than a short input may have: long ones find nothing more, but take longer.
const LONGEST: usize = 1 << 16;

/// A folder with good files, one of which gives way to the input.
pub struct Folder(TempDir);

impl Folder {
    pub fn new() -> Self {
        let folder = Self(TempDir::new().expect("a temporary folder"));
        folder.put("m.obj", OBJ.as_bytes());
        folder.put("m.mtl", MTL.as_bytes());
        folder.put("s.toml", SCENE.as_bytes());
        folder.put("p.png", PNG);
        folder.put("m.spd", b"400 0.1\n700 0.9\n");
        folder.put("b.bin", &[0, 0, 128, 63].repeat(64));
        folder
    }

    fn put(&self, name: &str, data: &[u8]) {
        std::fs::write(self.0.path().join(name), data).expect("a file in the folder");
    }

    /// Reads the bytes. They may be refused; a panic, a hang or an allocation without bound is a defect.
    pub fn read(&self, reader: Reader, data: &[u8]) {
        if data.len() > LONGEST || asks_for_much(data) {
            return;
        }
        let scene = |name: &str| {
            let scene = Scene::load(&self.0.path().join(name), &LoadOptions::default());
            match scene {
                Ok(scene) => assert!(!scene.triangles.is_empty()),
                Err(error) => assert!(!error.to_string().is_empty()),
            }
        };
        match reader {
            Reader::Obj => {
                self.put("input.obj", data);
                scene("input.obj");
            }
            Reader::Mtl => {
                self.put("m.mtl", data);
                scene("m.obj");
            }
            Reader::Scene => {
                self.put("input.toml", data);
                scene("input.toml");
            }
            Reader::Gltf => {
                self.put(if data.starts_with(b"glTF") { "input.glb" } else { "input.gltf" }, data);
                scene(if data.starts_with(b"glTF") { "input.glb" } else { "input.gltf" });
            }
            Reader::Ply => {
                self.put("input.ply", data);
                scene("input.ply");
            }
            Reader::Mitsuba => {
                self.put("input.xml", data);
                scene("input.xml");
            }
            Reader::Job => {
                self.put("job.toml", data);
                if let Err(error) = JobFile::load(&self.0.path().join("job.toml")) {
                    assert!(!error.to_string().is_empty());
                }
            }
        }
    }
}

/// True for scenes of millions of triangles and pictures of millions of pixels: that these take long is no defect.
fn asks_for_much(data: &[u8]) -> bool {
    let text = String::from_utf8_lossy(data);
    let keys = ["cells", "level", "triangles", "subdivide", "width", "height", "supersample"];
    keys.iter().any(|key| {
        text.match_indices(key).any(|(at, _)| {
            let value = text[at + key.len()..].trim_start_matches([' ', '\t', '=', '"', '\'']);
            let number = value.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').next().unwrap_or("");
            let most = match *key {
                "subdivide" | "level" => 1,
                "triangles" => 3,
                _ => 2,
            };
            number.len() > most || *key == "subdivide" && text.matches("subdivide").count() > 4
        })
    })
}
