//! The command-line tool as a process: what it refuses, its messages, and the files it writes.

mod ambiguities;
mod as_they_come;
mod backends;
mod batches;
mod examples;
mod fits;
#[path = "../support/obj.rs"]
mod obj;
mod pages;
mod pictures;
mod plans;
#[path = "../support/process.rs"]
mod process;
mod refusals;
mod signals;
#[path = "../support/tool.rs"]
mod tool;
mod traces;
mod warnings;

use std::path::Path;
use std::process::Command;
use tool::{Folder, MTL, OBJ, ROOM, Run, names, run, says};

/// Hides all drivers from the Vulkan loader. Older loaders know the second name only.
fn without_driver<'a>(command: &'a mut Command, driver_file: &Path) -> &'a mut Command {
    command.env("VK_DRIVER_FILES", driver_file).env("VK_ICD_FILENAMES", driver_file)
}
