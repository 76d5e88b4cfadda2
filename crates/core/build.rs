//! Writes `$OUT_DIR/shaders.rs`, which `crates/core/src/shaders.rs` includes: every `glsl/NAME.comp` as SPIR-V. Modules come from
//! `spirv/` while they match the sources, so that a build needs no shader compiler; `glslc` compiles what was edited
//! since. `spirv/manifest` says what each module was compiled from. `scripts/shaders` renews the folder: it runs this
//! program with the argument `renew`.

use std::collections::{BTreeMap, BTreeSet};
use std::env;
use std::fmt::Write as _;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

/// Relative to the root, where `glslc` runs: no path of the building machine gets into the SPIR-V.
const GLSL: &str = "glsl";
const SPIRV: &str = "spirv";
const MANIFEST: &str = "manifest";
/// `-g` keeps the names: validation messages and profiles stay readable, and tests check layouts by member name.
const OPTIONS: [&str; 7] = ["--target-env=vulkan1.2", "-std=450core", "-O", "-g", "-Werror", "-I", GLSL];
const INSTALL: &str = "`glslc` compiles edited shaders and is not in PATH: install it (`apt install glslc`, `dnf install \
    glslc`, `brew install shaderc` or the Vulkan SDK), or undo the edit";

fn main() -> ExitCode {
    let sources = Sources { root: Path::new("."), glslc: "glslc" };
    let done = match env::var_os("OUT_DIR").map(PathBuf::from) {
        None => Err("OUT_DIR is not set: run through cargo or scripts/shaders".to_owned()),
        Some(out) if env::args().any(|argument| argument == "renew") => sources.renew(&out),
        Some(out) => build(&sources, &out),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            for line in message.lines() {
                println!("cargo::error={line}");
            }
            ExitCode::FAILURE
        }
    }
}

fn build(sources: &Sources, out: &Path) -> Result<(), String> {
    println!("cargo::rerun-if-changed={GLSL}");
    println!("cargo::rerun-if-changed={SPIRV}");
    let generated = out.join("shaders.rs");
    fs::write(&generated, sources.rust(out)?).map_err(|error| format!("{}: {error}", generated.display()))
}

/// A root with `glsl/` and `spirv/`, and the compiler's command.
pub struct Sources<'a> {
    pub root: &'a Path,
    pub glslc: &'a str,
}

/// One module: a shader compiled with some macros defined.
pub struct Module {
    /// Name of its file in `spirv/`, without the ending.
    pub name: String,
    /// File name in `glsl/`.
    shader: String,
    defines: &'static [&'static str],
    /// Hash of everything it is compiled from.
    pub fingerprint: u64,
}

/// The manifest of `spirv/`.
pub struct Manifest {
    /// Name and version of the compiler of the modules.
    pub compiler: String,
    /// Hash of the sources of each module, by its name.
    pub fingerprints: BTreeMap<String, u64>,
}

impl Sources<'_> {
    /// Each shader, and each that includes `real.glsl` a second time in f64, sorted by the shader's name, so that the
    /// generated file is the same on every machine.
    pub fn modules(&self) -> Result<Vec<Module>, String> {
        let folder = self.root.join(GLSL);
        let failed = |error| format!("{}: {error}", folder.display());
        let mut shaders = Vec::new();
        for entry in fs::read_dir(&folder).map_err(failed)? {
            let shader = entry.map_err(failed)?.file_name();
            shaders.push(shader.into_string().map_err(|name| format!("{name:?}: a name that is not UTF-8"))?);
        }
        shaders.sort();
        let mut modules = Vec::new();
        for shader in shaders {
            let Some(name) = shader.strip_suffix(".comp") else { continue };
            let mut files = BTreeMap::new();
            self.gather(&shader, &mut files)?;
            let module = |name: String, defines: &'static [&str]| Module {
                name,
                shader: shader.clone(),
                defines,
                fingerprint: fingerprint(&files, defines),
            };
            modules.push(module(name.to_owned(), &[]));
            if files.contains_key("real.glsl") {
                modules.push(module(format!("{name}_f64"), &["F64"]));
            }
        }
        let mut names = BTreeSet::new();
        match modules.iter().find(|module| !names.insert(module.name.as_str())) {
            // Pipelines are cached by the name of their shader.
            Some(twice) => {
                Err(format!("{GLSL}/{}: there are two shaders \"{}\": rename one", twice.shader, twice.name))
            }
            None => Ok(modules),
        }
    }

    /// A file of `glsl/` and its direct and indirect includes: name and text.
    fn gather(&self, file: &str, files: &mut BTreeMap<String, String>) -> Result<(), String> {
        if files.contains_key(file) {
            return Ok(());
        }
        let path = self.root.join(GLSL).join(file);
        let text = fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        files.insert(file.to_owned(), text.clone());
        let included = text.lines().filter_map(|line| line.strip_prefix("#include \"")?.strip_suffix('"'));
        for head in included {
            self.gather(head, files)?;
        }
        Ok(())
    }

    /// The Rust source of all shaders. What needs compiling is compiled into `out`.
    pub fn rust(&self, out: &Path) -> Result<String, String> {
        let shipped = self.manifest()?.fingerprints;
        let mut literals = Vec::new();
        for module in self.modules()? {
            let words = match shipped.get(&module.name) {
                Some(fingerprint) if *fingerprint == module.fingerprint => self.shipped(&module.name)?,
                _ => self.compiled(&module, out, &[])?,
            };
            literals.push((format!("Shader::new({:?}, &{words:?})", module.name), module));
        }
        let mut source = String::new();
        let mut all = String::new();
        let mut rest = literals.iter().peekable();
        while let Some((single, module)) = rest.next() {
            let constant = module.name.to_uppercase();
            if let Some((double, _)) = rest.next_if(|(_, next)| next.shader == module.shader) {
                let _ = writeln!(
                    source,
                    "/// `{GLSL}/{}`.\npub static {constant}: RealShader = RealShader {{ f32: {single}, f64: {double} }};",
                    module.shader
                );
                let _ = write!(all, "&{constant}.f32, &{constant}.f64, ");
            } else {
                let _ = writeln!(
                    source,
                    "/// `{GLSL}/{}`.\npub static {constant}: Shader = {single};",
                    module.shader
                );
                let _ = write!(all, "&{constant}, ");
            }
        }
        let _ = writeln!(source, "/// Every shader of the crate.\npub static ALL: &[&Shader] = &[{all}];");
        Ok(source)
    }

    /// The manifest; empty if there is none.
    pub fn manifest(&self) -> Result<Manifest, String> {
        let path = self.root.join(SPIRV).join(MANIFEST);
        let text = match fs::read_to_string(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => String::new(),
            read => read.map_err(|error| format!("{}: {error}", path.display()))?,
        };
        let mut manifest = Manifest { compiler: String::new(), fingerprints: BTreeMap::new() };
        for (at, line) in text.lines().enumerate() {
            let broken = || format!("{}:{}: not written by scripts/shaders; run it", path.display(), at + 1);
            let (name, value) = line.split_once(": ").ok_or_else(broken)?;
            if name == "compiler" {
                manifest.compiler = value.to_owned();
            } else {
                let fingerprint = u64::from_str_radix(value, 16).map_err(|_| broken())?;
                manifest.fingerprints.insert(name.to_owned(), fingerprint);
            }
        }
        Ok(manifest)
    }

    /// The words of a module in `spirv/`.
    pub fn shipped(&self, name: &str) -> Result<Vec<u32>, String> {
        words(&self.root.join(SPIRV).join(name).with_extension("spv"))
    }

    /// Compiles and checks a module into a file in `out`. Of contradicting options the last counts.
    pub fn compiled(&self, module: &Module, out: &Path, more: &[&str]) -> Result<Vec<u32>, String> {
        let spv = out.join(&module.name).with_extension("spv");
        let output = Command::new(self.glslc)
            .current_dir(self.root)
            .args(OPTIONS)
            .args(more)
            .args(module.defines.iter().map(|name| format!("-D{name}")))
            .arg("-o")
            .arg(&spv)
            .arg(format!("{GLSL}/{}", module.shader))
            .output()
            .map_err(|error| match error.kind() {
                ErrorKind::NotFound => format!("{GLSL}/{}: {INSTALL}", module.shader),
                _ => format!("{}: {error}", self.glslc),
            })?;
        if !output.status.success() {
            return Err(text(&output.stdout, &output.stderr));
        }
        let words = without_source(&words(&spv)?);
        write_words(&spv, &words)?;
        validate(module, &spv)?;
        Ok(words)
    }

    /// Name and version of the compiler.
    pub fn compiler(&self) -> Result<String, String> {
        let output =
            Command::new(self.glslc).arg("--version").output().map_err(|_| INSTALL.to_owned())?.stdout;
        let version = String::from_utf8_lossy(&output);
        Ok(version.lines().take_while(|line| !line.is_empty()).collect::<Vec<_>>().join(", "))
    }

    /// Compiles everything again, in `out`; `spirv/` is written if all succeeds.
    fn renew(&self, out: &Path) -> Result<(), String> {
        let folder = self.root.join(SPIRV);
        let failed = |error| format!("{}: {error}", folder.display());
        let mut manifest = format!("compiler: {}\n", self.compiler()?);
        let compiled = |module: Module| Ok((self.compiled(&module, out, &[])?, module));
        let modules = self.modules()?.into_iter().map(compiled).collect::<Result<Vec<_>, String>>()?;
        match fs::remove_dir_all(&folder) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(failed(error)),
            _ => fs::create_dir(&folder).map_err(failed)?,
        }
        for (words, module) in modules {
            write_words(&folder.join(&module.name).with_extension("spv"), &words)?;
            let _ = writeln!(manifest, "{}: {:016x}", module.name, module.fingerprint);
        }
        fs::write(folder.join(MANIFEST), manifest).map_err(failed)
    }
}

/// FNV-1a of options and files. Lines are hashed without their ends, which git may change, and without comments.
fn fingerprint(files: &BTreeMap<String, String>, defines: &[&str]) -> u64 {
    let code = |line| str::split_once(line, "//").map_or(line, |(code, _)| code).trim_end();
    let of_files =
        files.iter().flat_map(|(name, text)| [name.as_str()].into_iter().chain(text.lines().map(code)));
    let of_files = of_files.filter(|line| !line.is_empty());
    let lines = OPTIONS.iter().chain(defines).copied().chain(of_files);
    let bytes = lines.flat_map(|line| line.bytes().chain([b'\n']));
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

/// The module without its source text and line numbers, which would make up half of it and change with every comment.
/// Names stay.
fn without_source(words: &[u32]) -> Vec<u32> {
    const HEADER: usize = 5;
    const OP_SOURCE_CONTINUED: u32 = 2;
    const OP_SOURCE: u32 = 3;
    const OP_LINE: u32 = 8;
    const OP_NO_LINE: u32 = 317;
    let (header, mut rest) = words.split_at(HEADER.min(words.len()));
    let mut kept = header.to_vec();
    while let Some(&first) = rest.first() {
        let (instruction, tail) = rest.split_at(((first >> 16) as usize).clamp(1, rest.len()));
        match first & 0xffff {
            OP_SOURCE_CONTINUED | OP_LINE | OP_NO_LINE => {}
            // Language and version alone.
            OP_SOURCE => kept.extend([OP_SOURCE | 3 << 16, instruction[1], instruction[2]]),
            _ => kept.extend(instruction),
        }
        rest = tail;
    }
    kept
}

fn words(spv: &Path) -> Result<Vec<u32>, String> {
    let bytes = fs::read(spv).map_err(|error| format!("{}: {error}", spv.display()))?;
    let (words, []) = bytes.as_chunks::<4>() else {
        return Err(format!("{}: not a whole number of words", spv.display()));
    };
    Ok(words.iter().copied().map(u32::from_le_bytes).collect())
}

fn write_words(spv: &Path, words: &[u32]) -> Result<(), String> {
    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    fs::write(spv, bytes).map_err(|error| format!("{}: {error}", spv.display()))
}

/// Runs `spirv-val` if it is installed: a second check, for which most hosts need no extra dependency.
fn validate(module: &Module, spv: &Path) -> Result<(), String> {
    match Command::new("spirv-val")
        .args(["--target-env", "vulkan1.2", "--scalar-block-layout"])
        .arg(spv)
        .output()
    {
        Ok(output) if output.status.success() => Ok(()),
        Ok(output) => {
            let said = text(&output.stdout, &output.stderr);
            Err(format!("{GLSL}/{}: spirv-val: {said}", module.shader))
        }
        Err(_) => Ok(()),
    }
}

fn text(stdout: &[u8], stderr: &[u8]) -> String {
    format!("{}{}", String::from_utf8_lossy(stdout), String::from_utf8_lossy(stderr))
}
