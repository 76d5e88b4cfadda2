//! The compiled shaders, and how the build obtains them.

// The build script itself, under test.
#[allow(dead_code, reason = "`main` and what only it calls")]
#[path = "../../crates/core/build.rs"]
mod build;

use antirad::scene::Precision;
use antirad_core::shaders;
use antirad_gpu as gpu;
use antirad_gpu::Shader;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use crate::Axpy;
use crate::reflect::member_offsets;
use build::{Module, Sources};

/// The crate that the shaders are part of.
const CORE: &str = "crates/core";

fn here() -> Sources<'static> {
    Sources { root: Path::new(CORE), glslc: "glslc" }
}

/// The interface of a module on which the host relies.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Interface {
    /// Entry point, capabilities, bindings, specialisation constants, strides.
    lines: BTreeSet<String>,
    /// Offset of each member of each structure.
    members: BTreeMap<(String, String), u32>,
}

impl Interface {
    fn of(spirv: &[u32]) -> Self {
        use rspirv::dr::Operand::{Decoration, IdRef, LiteralBit32, LiteralString};
        use rspirv::spirv::{Decoration as Kind, Op};
        const LAYOUT: [Kind; 5] =
            [Kind::Binding, Kind::DescriptorSet, Kind::ArrayStride, Kind::Block, Kind::SpecId];
        let module = rspirv::dr::load_words(spirv).expect("SPIR-V");
        let called = |id: u32, member: Option<u32>| {
            module.debug_names.iter().find_map(|line| match (line.operands.as_slice(), member) {
                ([IdRef(of), LiteralString(text)], None) if *of == id => Some(text.clone()),
                ([IdRef(of), LiteralBit32(at), LiteralString(text)], Some(member))
                    if (*of, *at) == (id, member) =>
                {
                    Some(text.clone())
                }
                _ => None,
            })
        };
        // Blocks have names, their variables have none.
        let defined = |id: u32| module.types_global_values.iter().find(|line| line.result_id == Some(id));
        let block = |id: u32| {
            let variable = defined(id).filter(|line| line.class.opcode == Op::Variable)?;
            match defined(variable.result_type?)?.operands.as_slice() {
                [_, IdRef(of)] => called(*of, None),
                _ => None,
            }
        };
        let name = |id: u32| block(id).or_else(|| called(id, None)).unwrap_or_default();

        let mut members = BTreeMap::new();
        let mut lines = BTreeSet::new();
        for line in &module.annotations {
            match line.operands.as_slice() {
                [IdRef(of), LiteralBit32(at), Decoration(Kind::Offset), LiteralBit32(offset)] => {
                    members.insert((name(*of), called(*of, Some(*at)).unwrap_or_default()), *offset);
                }
                [IdRef(of), Decoration(kind), rest @ ..] if LAYOUT.contains(kind) => {
                    lines.insert(format!("{} {kind:?} {rest:?}", name(*of)));
                }
                _ => {}
            }
        }
        let capabilities = module.capabilities.iter().chain(&module.extensions).chain(&module.memory_model);
        lines.extend(capabilities.map(|line| format!("{:?}", line.operands)));
        // Without the variables, whose number depends on the optimiser.
        let entries = module.entry_points.iter();
        lines.extend(entries.map(|entry| format!("{:?} {:?}", entry.operands[0], entry.operands[2])));
        lines.extend(module.execution_modes.iter().map(|mode| format!("{:?}", &mode.operands[1..])));
        Self { lines, members }
    }

    /// Where the two disagree. A member that one of them lacks is unused.
    fn against(&self, other: &Self) -> Vec<String> {
        let lines = self.lines.symmetric_difference(&other.lines).cloned();
        let moved = self.members.iter().filter_map(|(member, offset)| {
            let there = other.members.get(member).filter(|there| *there != offset)?;
            Some(format!("{member:?} at {offset} and at {there}"))
        });
        lines.chain(moved).collect()
    }
}

/// All modules compiled from the sources as they are.
fn compiled(more: &[&str]) -> Vec<(Module, Vec<u32>)> {
    let folder = tempfile::tempdir().expect("a folder");
    let compile = |module: Module| {
        let words = here().compiled(&module, folder.path(), more).expect("a module");
        (module, words)
    };
    here().modules().expect("the shaders").into_par_iter().map(compile).collect()
}

#[test]
fn the_shipped_modules_are_of_these_sources() {
    let shipped = here().manifest().expect("a manifest").fingerprints;
    let sources = here().modules().expect("the shaders");
    let sources = sources.iter().map(|module| (module.name.clone(), module.fingerprint)).collect();
    assert_eq!(shipped, sources, "a shader was edited: run scripts/shaders");
    let files = fs::read_dir(Path::new(CORE).join("spirv"))
        .expect("the folder")
        .map(|entry| entry.expect("an entry").file_name());
    let files: BTreeSet<String> = files.map(|name| name.into_string().expect("UTF-8")).collect();
    let expected = shipped.keys().map(|name| format!("{name}.spv")).chain(["manifest".to_owned()]);
    assert_eq!(files, expected.collect());
}

/// Byte for byte if the compiler is the one that compiled them, else by the interface.
#[test]
fn the_shipped_modules_are_what_the_compiler_makes() {
    let Ok(compiler) = here().compiler() else {
        eprintln!("SKIPPED: no glslc to compare with");
        return;
    };
    let same = here().manifest().expect("a manifest").compiler == compiler;
    for (Module { name, .. }, built) in compiled(&[]) {
        let shipped = here().shipped(&name).expect("a shipped module");
        assert!(!same || shipped == built, "{name} is not what {compiler} makes: run scripts/shaders");
        let differences = Interface::of(&shipped).against(&Interface::of(&built));
        assert_eq!(differences, [""; 0], "{name}: run scripts/shaders");
    }
}

#[test]
#[ignore = "takes long: compiles all kernels once more, with another optimiser"]
fn the_interface_is_that_of_the_shader_not_of_the_optimiser() {
    if here().compiler().is_err() {
        eprintln!("SKIPPED: no glslc to compare with");
        return;
    }
    let others = compiled(&["-Os"]);
    let mut different = 0;
    let mut interfaces: BTreeMap<Interface, Vec<&str>> = BTreeMap::new();
    for (Module { name, .. }, other) in &others {
        let shipped = here().shipped(name).expect("a shipped module");
        different += usize::from(shipped != *other);
        let interface = Interface::of(other);
        assert_eq!(Interface::of(&shipped).against(&interface), [""; 0], "{name}");
        interfaces.entry(interface).or_default().push(name);
    }
    assert!(different > 0, "the other optimiser made no difference");
    // No two shaders look alike.
    assert!(interfaces.values().all(|names| names.len() == 1));

    // Changes that must be detected.
    let mut moved = Interface::of(shaders::COMBINE.of(Precision::F32).spirv());
    let combine = Interface::of(shaders::COMBINE.of(Precision::F32).spirv());
    moved.members.insert(("Push".to_owned(), "b".to_owned()), 8);
    assert_eq!(moved.against(&combine), ["(\"Push\", \"b\") at 8 and at 4"]);
    assert!(!Interface::of(shaders::COMBINE.of(Precision::F64).spirv()).against(&combine).is_empty());
    assert!(combine.lines.contains("X Binding [LiteralBit32(0)]"), "{:?}", combine.lines);
}

#[test]
fn only_edited_shaders_need_the_compiler() {
    let copy = tempfile::tempdir().expect("a folder");
    for folder in ["glsl", "spirv"] {
        fs::create_dir(copy.path().join(folder)).expect("a folder");
        for entry in fs::read_dir(Path::new(CORE).join(folder)).expect("a folder") {
            let entry = entry.expect("an entry");
            fs::copy(entry.path(), copy.path().join(folder).join(entry.file_name())).expect("a copy");
        }
    }
    let out = tempfile::tempdir().expect("a folder");
    let rust = |glslc: &str| Sources { root: copy.path(), glslc }.rust(out.path());
    let before = rust("no-such-glslc").expect("shipped modules alone");

    let shader = copy.path().join("glsl/combine.comp");
    let text = fs::read_to_string(&shader).expect("the shader");
    fs::write(&shader, text.replace("a * x[i] : ", "2.0 * a * x[i] : ")).expect("written");
    let error = rust("no-such-glslc").expect_err("an edited shader");
    assert!(error.contains("glsl/combine.comp") && error.contains("apt install glslc"), "{error}");
    if here().compiler().is_ok() {
        let after = rust("glslc").expect("the edited shader");
        let changed = before.lines().zip(after.lines()).filter(|(before, after)| before != after);
        let changed: Vec<&str> = changed.map(|(line, _)| line.split(':').next().unwrap_or(line)).collect();
        assert_eq!(changed, ["pub static COMBINE"]);
        assert_eq!(before.lines().count(), after.lines().count());
    }

    fs::write(&shader, text.replace('\n', "\r\n")).expect("written");
    assert_eq!(rust("no-such-glslc").expect("other ends of lines"), before);
    fs::write(&shader, format!("{text}// More.\n")).expect("written");
    assert_eq!(rust("no-such-glslc").expect("another comment"), before);
    // Editing a header affects every shader that includes it.
    let head = copy.path().join("glsl/real.glsl");
    let text = fs::read_to_string(&head).expect("the head");
    fs::write(&head, format!("{text}const int more = 1;\n")).expect("written");
    assert!(rust("no-such-glslc").is_err());
    fs::write(&head, text).expect("written");

    fs::write(copy.path().join("spirv/manifest"), "combine: sixteen\n").expect("written");
    let error = rust("no-such-glslc").expect_err("a broken manifest");
    assert!(error.contains("manifest:1:") && error.contains("scripts/shaders"), "{error}");
}

#[test]
fn layouts_shared_with_shaders_agree() {
    let offsets = member_offsets(shaders::COMBINE.of(Precision::F32).spirv(), "Push");
    let expected = [
        ("a".to_owned(), std::mem::offset_of!(Axpy, a) as u32),
        ("b".to_owned(), std::mem::offset_of!(Axpy, b) as u32),
        ("count".to_owned(), std::mem::offset_of!(Axpy, count) as u32),
    ];
    assert_eq!(offsets, expected);
}

#[test]
fn all_shaders_are_listed() {
    let names: Vec<_> = shaders::ALL.iter().copied().map(Shader::name).collect();
    assert!(names.contains(&"combine"));
    let single: Vec<_> = names.iter().filter(|name| !name.ends_with("_f64")).collect();
    assert!(single.is_sorted(), "{names:?}");
    assert!(names.contains(&"combine_f64"));
    // Profiles and errors tell kernels apart by their names.
    let mut unique = names.clone();
    unique.sort_unstable();
    unique.dedup();
    assert_eq!(unique.len(), names.len());
    // The magic number of SPIR-V.
    assert!(shaders::ALL.iter().all(|shader| shader.spirv()[0] == 0x0723_0203));
}

/// What Vulkan leaves to a device and `antirad devices` checks is what the kernels need.
#[test]
fn the_survey_asks_for_what_kernels_need() {
    use rspirv::dr::Operand::{Decoration, LiteralBit32};
    use rspirv::spirv::Decoration as Kind;
    let (mut bindings, mut lanes) = (0, 0);
    for shader in shaders::ALL {
        let module = rspirv::dr::load_words(shader.spirv()).expect("SPIR-V");
        for line in &module.annotations {
            if let [_, Decoration(Kind::Binding), LiteralBit32(binding)] = line.operands.as_slice() {
                bindings = bindings.max(binding + 1);
            }
        }
        for mode in &module.execution_modes {
            if let [_, _, LiteralBit32(x), LiteralBit32(y), LiteralBit32(z)] = mode.operands.as_slice() {
                lanes = lanes.max(x * y * z);
            }
        }
    }
    assert_eq!((bindings, lanes), (gpu::STORAGE_BUFFERS, gpu::WORKGROUP_LANES));
}

/// Metal takes no array whose length comes from the size of the workgroup.
#[test]
fn lengths_of_arrays_do_not_come_from_the_workgroup() {
    use rspirv::dr::Operand::{self, BuiltIn, Decoration, IdRef};
    use rspirv::spirv::{BuiltIn as Of, Decoration as Kind, Op};
    let mut arrays = 0;
    for shader in shaders::ALL {
        let module = rspirv::dr::load_words(shader.spirv()).expect("SPIR-V");
        let sizes: BTreeSet<u32> = module
            .annotations
            .iter()
            .filter_map(|line| match line.operands.as_slice() {
                [IdRef(of), Decoration(Kind::BuiltIn), BuiltIn(Of::WorkgroupSize)] => Some(*of),
                _ => None,
            })
            .collect();
        let constants: BTreeMap<u32, &[Operand]> = module
            .types_global_values
            .iter()
            .filter(|line| matches!(line.class.opcode, Op::SpecConstantOp | Op::SpecConstantComposite))
            .filter_map(|line| Some((line.result_id?, line.operands.as_slice())))
            .collect();
        for array in module.types_global_values.iter().filter(|line| line.class.opcode == Op::TypeArray) {
            arrays += 1;
            let mut from: Vec<u32> = array.operands[1..].iter().filter_map(Operand::id_ref_any).collect();
            while let Some(id) = from.pop() {
                assert!(!sizes.contains(&id), "{}: an array of gl_WorkGroupSize", shader.name());
                from.extend(
                    constants.get(&id).into_iter().copied().flatten().filter_map(Operand::id_ref_any),
                );
            }
        }
    }
    assert!(arrays > 20);
}
