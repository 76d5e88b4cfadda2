//! Tools as processes: a folder to run them in, and how a run ended.
#![allow(dead_code, reason = "every test crate uses a part")]

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// A room of 200 triangles with a lamp that hangs in it, so that there are bins and J to work on.
pub const ROOM: &str = r#"[[mesh]]
shape = { kind = "room", cells = 4 }
material = "wall"

[[mesh]]
name = "lamp"
shape = { kind = "quad", cells = 2 }
material = "lamp"
scale = 0.4
rotate_degrees = [180, 0, 0]
translate = [0.3, 0.98, 0.7]

[material.wall]
albedo = [0.7, 0.5, 0.3]

[material.lamp]
emission = 10

[camera.main]
position = [0.5, 0.5, 0.05]
target = [0.5, 0.5, 1]
fov_x_degrees = 85
width = 32
height = 24

[camera.side]
position = [0.05, 0.5, 0.5]
target = [1, 0.5, 0.5]
fov_x_degrees = 85
width = 16
height = 16
"#;

/// Two triangles on 8 lines; tests add lines after them.
pub const OBJ: &str =
    "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl lamp\nf 1 2 3\nusemtl white\nf 1 3 4\n";
pub const MTL: &str = "newmtl white\nKd .5 .5 .5\nnewmtl lamp\nKd .5 .5 .5\nKe 1 1 1\n";

/// How a run of the tool ended.
#[derive(Debug)]
pub struct Run {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl From<Output> for Run {
    fn from(output: Output) -> Self {
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("text in UTF-8");
        let run =
            Self { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) };
        assert!(!run.stderr.contains("panicked"), "{run:?}");
        run
    }
}

impl Run {
    #[track_caller]
    pub fn succeeded(self) -> Self {
        assert_eq!(self.code, Some(0), "{self:?}");
        self
    }

    /// Failed with one line that has these parts, and no other output.
    #[track_caller]
    pub fn refused(&self, parts: &[&str]) {
        assert_eq!(self.code, Some(2), "{self:?}");
        assert_eq!(self.stderr.lines().count(), 1, "{self:?}");
        let tools = ["antirad: ", "bench_accuracy: ", "bench_gradients: "];
        assert!(tools.iter().any(|tool| self.stderr.starts_with(tool)), "{self:?}");
        assert_eq!(self.stdout, "");
        says(&self.stderr, parts);
    }
}

#[track_caller]
pub fn says(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "`{part}` is missing in: {text}");
    }
}

/// A folder to run the tool in, with scenes: `room.toml`, and `m.obj` with `m.mtl`. Results go to `out`.
pub struct Folder(pub TempDir);

impl Folder {
    /// With these files in addition to the good ones, or instead of them.
    pub fn with(files: &[(&str, &str)]) -> Self {
        let folder = Self(TempDir::new().expect("a temporary folder"));
        for (name, text) in [("room.toml", ROOM), ("m.obj", OBJ), ("m.mtl", MTL)].iter().chain(files) {
            fs::write(folder.path(name), text).expect("a file in it");
        }
        folder
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The tool, at work in this folder.
    pub fn tool<S: AsRef<OsStr>>(&self, arguments: impl IntoIterator<Item = S>) -> Command {
        let mut tool = Command::new(option_env!("CARGO_BIN_EXE_antirad").unwrap_or("antirad"));
        tool.current_dir(self.0.path()).args(arguments);
        tool
    }

    /// Runs the tool with arguments that hold no blanks themselves.
    pub fn run(&self, arguments: &str) -> Run {
        run(&mut self.tool(arguments.split_whitespace()))
    }

    pub fn render(&self, arguments: &str) -> Run {
        self.run(&format!("render {arguments} --output out"))
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub fn json(&self, name: &str) -> serde_json::Value {
        serde_json::from_slice(&self.read(name)).expect("JSON")
    }

    /// Names of the results, hidden ones too; none where the folder for them was never made.
    pub fn results(&self) -> Vec<String> {
        names(&self.path("out"))
    }
}

pub fn run(command: &mut Command) -> Run {
    command.output().expect("the tool runs").into()
}

pub fn names(directory: &Path) -> Vec<String> {
    let Ok(entries) = fs::read_dir(directory) else { return Vec::new() };
    let name = |entry: std::io::Result<fs::DirEntry>| {
        entry.expect("an entry").file_name().into_string().expect("a name in UTF-8")
    };
    let mut names: Vec<String> = entries.map(name).collect();
    names.sort();
    names
}
