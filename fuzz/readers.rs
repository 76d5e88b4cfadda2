//! The readers of files, fed with bytes: by cargo-fuzz, and by a test on stable Rust.

use antirad::fit::JobFile;
use antirad::scene::{CameraSet, LoadOptions, Scene};
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
    Cameras,
}

const OBJ: &str =
    "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl lamp\nf 1 2 3\nusemtl white\nf 1 3 4\n";
const MTL: &str = "newmtl white\nKd .5 .5 .5\nnewmtl lamp\nKd .5 .5 .5\nKe 1 1 1\n";
const SCENE: &str = "[[mesh]]\npath = \"m.obj\"\n[camera.main]\nposition = [0, 0, 5]\ntarget = [0, 0, 0]\n\
                     fov_x_degrees = 40\nwidth = 4\nheight = 4\n";
/// A set of cameras with one frame, whose picture is `p.png`.
const TRANSFORMS: &[u8] = b"{\"fl_x\": 4, \"frames\": [{\"file_path\": \"p\", \"transform_matrix\": \
                            [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]]}]}";
/// Between the two files of COLMAP in one input.
const NEXT_FILE: &[u8] = b"\n====\n";
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
        folder.put("t.json", TRANSFORMS);
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
            Reader::Cameras => self.read_cameras(data),
            Reader::Job => {
                self.put("job.toml", data);
                if let Err(error) = JobFile::load(&self.0.path().join("job.toml")) {
                    assert!(!error.to_string().is_empty());
                }
            }
        }
    }
}

impl Folder {
    /// A `transforms.json`, or `cameras` and `images` of COLMAP: as text after a `T`, else binary.
    fn read_cameras(&self, data: &[u8]) {
        let suffix = if data.starts_with(b"T") { "txt" } else { "bin" };
        let folder = self.0.path().join("colmap");
        let set = if data.starts_with(b"{") {
            self.put("input.json", data);
            CameraSet::read(&self.0.path().join("input.json"))
        } else {
            let rest = data.get(1..).unwrap_or_default();
            let at = rest.windows(NEXT_FILE.len()).position(|part| part == NEXT_FILE);
            let (first, second) = match at {
                Some(at) => (&rest[..at], &rest[at + NEXT_FILE.len()..]),
                None => (rest, &[][..]),
            };
            let _ = std::fs::remove_dir_all(&folder);
            std::fs::create_dir(&folder).expect("a folder");
            self.put(&format!("colmap/cameras.{suffix}"), first);
            self.put(&format!("colmap/images.{suffix}"), second);
            CameraSet::read(&folder)
        };
        let set = match set {
            Ok(set) => set,
            Err(error) => return assert!(!error.to_string().is_empty()),
        };
        assert!(!set.frames.is_empty());
        for frame in &set.frames {
            assert!(set.frame(&frame.name) == Some(frame) && !frame.name.is_empty());
            if let Ok(lens) = frame.intrinsics.lens([4, 4]) {
                let camera = frame.camera(&lens, 4, 4);
                assert!(camera.fov_x_degrees > 0.0 && camera.fov_x_degrees < 180.0);
            }
            if let Err(error) = set.picture(frame, None, None) {
                assert!(!error.to_string().is_empty());
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
