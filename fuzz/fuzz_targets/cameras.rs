#![no_main]

#[path = "../readers.rs"]
mod readers;

use readers::{Folder, Reader};

thread_local!(static FOLDER: Folder = Folder::new());

libfuzzer_sys::fuzz_target!(|data: &[u8]| FOLDER.with(|folder| folder.read(Reader::Cameras, data)));
