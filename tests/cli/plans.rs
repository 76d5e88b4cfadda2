//! `antirad plan` and `antirad devices`.

use crate::{Folder, run, says, without_driver};
use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::Path;

/// A plan needs no Vulkan driver and does not depend on a device, for either backend.
#[test]
fn a_plan_needs_no_device() {
    let folder = Folder::with(&[]);
    let nowhere = Path::new("/nowhere.json");
    let of_cpu = || folder.tool(["plan", "room.toml", "--backend", "cpu", "--json"]);
    let planned = run(without_driver(&mut of_cpu(), nowhere)).succeeded();
    assert_eq!(planned.stderr, "");
    let plan: serde_json::Value = serde_json::from_str(&planned.stdout).expect("JSON");
    // Cut from 200.
    assert!(plan["triangles"].as_u64() > Some(200), "{plan}");
    assert_eq!(plan["resolved"][0]["setting"], "mesh");
    let items = plan["memory"].as_array().expect("memory by label");
    let bytes: u64 = items.iter().map(|item| item["bytes"].as_u64().expect("bytes")).sum();
    assert_eq!(plan["memory_total"], bytes);
    let classes = plan["classes"].as_array().expect("classes");
    let triangles: u64 = classes.iter().map(|class| class["triangles"].as_u64().expect("a count")).sum();
    assert_eq!(plan["triangles"], triangles);
    assert_eq!(planned.stdout, run(&mut of_cpu()).succeeded().stdout);
    let mut tool = folder.tool(["plan", "room.toml", "--backend", "vulkan", "--json"]);
    let planned = run(without_driver(&mut tool, nowhere)).succeeded();
    let of_vulkan: serde_json::Value = serde_json::from_str(&planned.stdout).expect("JSON");
    let staging = |plan: &serde_json::Value| {
        plan["memory"].as_array().expect("memory by label").iter().any(|item| item["label"] == "staging")
    };
    assert!(staging(&of_vulkan) && !staging(&plan));

    let words = run(without_driver(&mut folder.tool(["plan", "room.toml"]), nowhere)).succeeded().stdout;
    says(&words, &["mesh ", "visibility  explicit: by rays", "triangles  "]);
    assert!(!folder.path("out").exists());
}

#[test]
fn a_plan_keeps_to_the_settings_given() {
    let folder = Folder::with(&[]);
    folder.run("plan room.toml --memory-budget 64KiB").refused(&["65536 bytes is too small"]);
    folder.run("plan nowhere.toml").refused(&["nowhere.toml", "cannot be read"]);
    let planned = folder
        .run("plan room.toml --visibility implicit --bins concentric:4 --solver fixed-point --json")
        .succeeded();
    let plan: serde_json::Value = serde_json::from_str(&planned.stdout).expect("JSON");
    assert_eq!(plan["bins"], "concentric:4");
    assert_eq!(plan["solver"], "fixed point");
}

/// Where memory of a Vulkan device is short, states go to the host, and the plan reports the traffic.
#[test]
fn a_plan_for_little_memory() {
    let folder = Folder::with(&[]);
    let plan = |budget: &str| -> serde_json::Value {
        let planned =
            format!("plan room.toml --visibility implicit --backend vulkan --json --memory-budget {budget}");
        let planned = folder.run(&planned);
        let planned = planned.succeeded();
        serde_json::from_str(&planned.stdout).expect("JSON")
    };
    let plenty = plan("1GiB");
    let refused =
        folder.run("plan room.toml --visibility implicit --backend vulkan --memory-budget 1").stderr;
    let least = refused.split("--memory-budget ").nth(1).and_then(|rest| rest.split(',').next());
    let least: u64 = least.and_then(|n| n.parse().ok()).expect("a number of bytes");
    let budget = least + least / 2;
    let little = plan(&budget.to_string());
    assert_eq!(plenty["states"]["residency"], "device");
    assert_eq!(plenty["states"]["bytes_moved_per_pass"], 0);
    assert_eq!(little["states"]["residency"], "host");
    assert_eq!(little["solver"], plenty["solver"]);
    assert!(little["memory_total"].as_u64().expect("bytes") <= budget);
    assert!(little["states"]["host_bytes"].as_u64().expect("bytes") > budget / 4);
    let words = folder
        .run(&format!("plan room.toml --visibility implicit --backend vulkan --memory-budget {budget}"));
    let words = words.succeeded().stdout;
    let moved = little["states"]["bytes_moved_per_pass"].to_string();
    says(&words, &["states           on the host", &format!("{moved}  bytes moved per pass")]);
}

#[test]
fn devices_are_listed_with_what_they_lack() {
    let folder = Folder::with(&[]);
    let listed = folder.run("devices").succeeded();
    assert_eq!(listed.stderr, "");
    says(&listed.stdout, &["0: ", "memory", "subgroup", "has all it needs"]);
    // The backends come first, with what each of them has.
    assert!(listed.stdout.starts_with("backend cpu: "), "{}", listed.stdout);
    says(
        &listed.stdout,
        &["threads", "vectors", "memory budget", "\nbackend vulkan", "taken unless another"],
    );
    let mut tool = folder.tool(["devices"]);
    let without = run(without_driver(tool.env_remove("ANTIRAD_BACKEND"), Path::new("/nowhere.json")));
    let told = without.succeeded().stdout;
    says(&told, &["no Vulkan d", "mesa-vulkan-drivers"]);
    let first = told.lines().next().unwrap_or_default();
    assert!(
        first.starts_with("backend cpu: ") && first.ends_with("(taken unless another is asked for)"),
        "{told}"
    );
}

/// RADV compiles for GPUs that are not there. A kernel that takes more registers or scratch memory than it did is slower. The table is
/// what Mesa 22.3.6 tells: `RADV_FORCE_FAMILY=navi21 antirad devices --kernels=tests/cli/kernels_navi21.csv` with RADV as the only
/// driver (VK_DRIVER_FILES).
#[test]
fn kernels_take_no_more_of_a_gpu() {
    let drivers = fs::read_dir("/usr/share/vulkan/icd.d").into_iter().flatten().flatten();
    let mut drivers = drivers.map(|entry| entry.path());
    let Some(driver) = drivers.find(|path| path.to_string_lossy().contains("/radeon_icd")) else {
        eprintln!("not checked: there is no RADV (mesa-vulkan-drivers)");
        return;
    };
    let folder = Folder::with(&[]);
    let mut command = folder.tool(["devices", "--kernels=kernels.csv"]);
    run(without_driver(command.env("RADV_FORCE_FAMILY", "navi21"), &driver)).succeeded();
    let read = |path: &Path| -> Vec<HashMap<String, String>> {
        let rows = csv::Reader::from_path(path).expect("a table").into_deserialize();
        rows.map(|row| row.expect("a row")).collect()
    };
    let found = read(&folder.path("kernels.csv"));
    let table = read(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/cli/kernels_navi21.csv")));
    let key = |row: &HashMap<String, String>| [row["kernel"].clone(), row["specialization"].clone()];
    let keys = |rows: &[HashMap<String, String>]| rows.iter().map(key).collect::<Vec<_>>();
    assert_eq!(keys(&found), keys(&table), "kernels have come or gone");
    let sources =
        fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/crates/core/glsl")).expect("a folder").flatten();
    let sources = sources.filter_map(|source| source.file_name().into_string().ok());
    let all: BTreeSet<String> =
        sources.filter_map(|name| name.strip_suffix(".comp").map(String::from)).collect();
    let compiled: BTreeSet<String> = found.iter().map(|row| row["kernel"].clone()).collect();
    assert_eq!(compiled, all, "not every kernel is compiled");
    for (found, known) in found.iter().zip(&table) {
        let of = |row: &HashMap<String, String>, name: &str| -> f64 { row[name].parse().expect("a number") };
        // Another version of the compiler may need a few more.
        for (name, factor) in [("VGPRs", 1.15), ("Scratch size", 1.0), ("LDS size", 1.0)] {
            let (found, most) = (of(found, name), factor * of(known, name) + 8.0 * (factor - 1.0) / 0.15);
            assert!(found <= most, "{:?}, {name}: {found} is more than {most}", key(known));
        }
        let name = "Subgroups per SIMD";
        let (found, least) = (of(found, name), (0.8 * of(known, name)).floor());
        assert!(found >= least, "{:?}, {name}: {found} is less than {least}", key(known));
    }
}

#[test]
fn help_and_version() {
    let folder = Folder::with(&[]);
    says(&folder.run("--help").succeeded().stdout, &["render", "plan", "devices"]);
    says(&folder.run("--version").succeeded().stdout, &["antirad", env!("CARGO_PKG_VERSION")]);
    assert_eq!(folder.run("").code, Some(2));
}
