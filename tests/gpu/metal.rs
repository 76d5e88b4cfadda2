//! Metal, through what MoltenVK does there: SPIRV-Cross translates modules to the Metal shading language.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::process::Command;

/// MSL 2.3, and the ways in which MoltenVK binds buffers.
const OPTIONS: [&[&str]; 2] = [
    &["--msl", "--msl-version", "20300"],
    &["--msl", "--msl-version", "20300", "--msl-argument-buffers", "--msl-decoration-binding"],
];

fn translated(spirv_cross: &str, module: &Path, options: &[&str]) -> Result<String, String> {
    let run = Command::new(spirv_cross).arg(module).args(options).output();
    let run = run.map_err(|error| format!("{spirv_cross}: {error}"))?;
    match run.status.success() {
        true => Ok(String::from_utf8_lossy(&run.stdout).into_owned()),
        false => Err(String::from_utf8_lossy(&run.stderr).into_owned()),
    }
}

/// Arrays whose size is no constant of the language: neither a number, nor a macro of a specialization constant, nor computed from such. A
/// function constant is none, and neither is what the size of a workgroup becomes, as that is one.
fn arrays_of_no_constant_size(msl: &str) -> Vec<String> {
    let constants: BTreeMap<&str, &str> = msl
        .lines()
        .filter_map(|line| line.strip_prefix("constant ")?.strip_suffix(';')?.split_once(" = "))
        .filter_map(|(declared, value)| Some((declared.split_whitespace().nth(1)?, value)))
        .collect();
    let sizes = msl.lines().flat_map(|line| {
        let shared = line.trim().strip_prefix("threadgroup ").and_then(|line| line.strip_suffix("];"));
        let shared = shared.and_then(|line| line.rsplit_once('['));
        let own = line
            .split("spvUnsafeArray<")
            .skip(1)
            .filter_map(|rest| rest.split_once('>')?.0.rsplit_once(", "));
        shared.into_iter().chain(own).map(move |(_, size)| (line, size))
    });
    let of_no_constant = |(_, size): &(&str, &str)| !is_constant(size, &constants);
    sizes.filter(of_no_constant).map(|(line, _)| line.trim().to_owned()).collect()
}

fn is_constant(expression: &str, constants: &BTreeMap<&str, &str>) -> bool {
    let words = expression.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|word| !word.is_empty());
    words.into_iter().all(|word| {
        word.starts_with(|c: char| c.is_ascii_digit())
            || word.starts_with("SPIRV_CROSS_CONSTANT_ID_")
            || ["int", "uint", "bool", "true", "false"].contains(&word)
            || constants.get(word).is_some_and(|value| is_constant(value, constants))
    })
}

/// Every module but those in double precision, which Metal lacks: a device there has no `shaderFloat64`, and they are not asked for.
#[test]
fn every_module_is_one_for_metal() {
    const TOOL: &str = "spirv-cross";
    if Command::new(TOOL).arg("--revision").output().is_err() {
        eprintln!("SKIPPED: no {TOOL} to translate with (scripts/setup)");
        return;
    }
    let modules =
        fs::read_dir("crates/core/spirv").expect("the folder").map(|entry| entry.expect("an entry").path());
    let modules: BTreeSet<_> = modules.filter(|path| path.extension().is_some_and(|e| e == "spv")).collect();
    let mut checked = 0;
    for module in &modules {
        let double = module.file_stem().is_some_and(|name| name.to_string_lossy().ends_with("_f64"));
        for options in OPTIONS {
            match translated(TOOL, module, options) {
                Err(why) if double => assert!(why.contains("double"), "{}: {why}", module.display()),
                Ok(_) if double => panic!("{}: Metal has no doubles", module.display()),
                Err(why) => panic!("{} {options:?}: {why}", module.display()),
                Ok(msl) => {
                    assert!(msl.contains("kernel void"), "{}", module.display());
                    let wrong = arrays_of_no_constant_size(&msl);
                    assert!(wrong.is_empty(), "{} {options:?}: {wrong:?}", module.display());
                    checked += msl.lines().filter(|line| line.trim().starts_with("threadgroup ")).count();
                }
            }
        }
    }
    assert!(modules.len() > 45 && checked > 50, "{} modules, {checked} lines", modules.len());
}

/// What SPIRV-Cross makes of `shared float x[gl_WorkGroupSize.x]`, which Metal refuses, and of sizes that it takes.
#[test]
fn arrays_by_the_size_of_a_workgroup_are_found() {
    let msl = "constant uint N = SPIRV_CROSS_CONSTANT_ID_1;
constant uint _18_tmp [[function_constant(0)]];
constant uint _18 = is_function_constant_defined(_18_tmp) ? _18_tmp : 1u;
constant uint3 gl_WorkGroupSize [[maybe_unused]] = uint3(_18, 1u, 1u);
constant uint _23 = gl_WorkGroupSize.x;
constant bool MANY = (N > 1u);
constant uint _30 = (3u * N);
constant uint M = MANY ? _30 : 1u;
kernel void main0()
{
    threadgroup float x[_23];
    threadgroup float y[M];
    threadgroup float3 z[64];
    spvUnsafeArray<float, _18> own;
    spvUnsafeArray<float3, N> other;
    threadgroup float unknown[SIZE];
}
";
    let found = arrays_of_no_constant_size(msl);
    let wrong =
        ["threadgroup float x[_23];", "spvUnsafeArray<float, _18> own;", "threadgroup float unknown[SIZE];"];
    assert_eq!(found, wrong);
}
