//! Compiled kernels on disk, so that the next process need not compile them again.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

use ash::vk;
use sha2::{Digest, Sha256};

use antirad_base::input;
use antirad_base::output::atomic_write;

/// The folder that keeps compiled kernels unless options say otherwise: ANTIRAD_KERNEL_CACHE, or `antirad` in
/// the user's folder for caches.
pub(super) fn usual_folder() -> Option<PathBuf> {
    let set = |name| env::var_os(name).filter(|text| !text.is_empty()).map(PathBuf::from);
    if let Some(given) = env::var_os("ANTIRAD_KERNEL_CACHE") {
        return (!given.is_empty()).then(|| given.into());
    }
    let base = if cfg!(windows) {
        set("LOCALAPPDATA")
    } else if cfg!(target_os = "macos") {
        set("HOME").map(|home| home.join("Library/Caches"))
    } else {
        set("XDG_CACHE_HOME").or_else(|| set("HOME").map(|home| home.join(".cache")))
    };
    base.map(|base| base.join("antirad"))
}

/// The file of one device with one version of its driver. What cannot be read or written is compiled again, and is no
/// error.
pub(super) struct KernelCache {
    path: PathBuf,
    /// The driver's data as it is on disk; empty if there is none.
    known: Vec<u8>,
    /// Whether the path may be written: a pipe or a device there would take bytes without end, or none.
    writable: bool,
}

const CHECKSUM: usize = 32;

impl KernelCache {
    pub(super) fn open(folder: &Path, of: &vk::PhysicalDeviceProperties) -> Self {
        let uuid: String = of.pipeline_cache_uuid.iter().map(|byte| format!("{byte:02x}")).collect();
        let name = format!("kernels-{:x}-{:x}-{:x}-{uuid}", of.vendor_id, of.device_id, of.driver_version);
        let path = folder.join(name);
        let read = input::read(&path);
        let writable = match &read {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                tracing::warn!("{}: kernels are compiled anew and not kept: {error}", path.display());
                false
            }
            _ => true,
        };
        let known = read.ok().and_then(checked).unwrap_or_default();
        Self { path, known, writable }
    }

    pub(super) fn data(&self) -> &[u8] {
        &self.known
    }

    /// Replaces what is on disk, if it differs.
    pub(super) fn keep(&self, data: &[u8]) {
        if data == self.known || !self.writable {
            return;
        }
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let write = || -> io::Result<()> {
            fs::create_dir_all(folder)?;
            let write = |file: &mut fs::File| {
                io::Write::write_all(file, &Sha256::digest(data))?;
                io::Write::write_all(file, data)
            };
            atomic_write(&self.path, write).map_err(|error| error.reason)
        };
        match write() {
            Ok(()) => tracing::debug!("kept {} bytes of kernels in {}", data.len(), self.path.display()),
            Err(error) => tracing::debug!("{}: kernels are not kept: {error}", self.path.display()),
        }
    }
}

/// The content behind a correct checksum: drivers trust what they are given.
fn checked(mut file: Vec<u8>) -> Option<Vec<u8>> {
    let data = file.split_off(CHECKSUM.min(file.len()));
    (Sha256::digest(&data).as_slice() == file).then_some(data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shader::engine_kernel;
    use crate::{Device, DeviceOptions, Pipeline};

    fn files(folder: &Path) -> Vec<PathBuf> {
        let entries = fs::read_dir(folder).into_iter().flatten();
        entries.map(|entry| entry.expect("an entry").path()).collect()
    }

    #[test]
    fn damaged_data_is_left_aside() {
        let folder = tempfile::tempdir().expect("a folder");
        let of = vk::PhysicalDeviceProperties::default();
        let open = || KernelCache::open(&folder.path().join("new"), &of);
        assert_eq!(open().data(), b"");
        open().keep(b"kernels");
        assert_eq!(open().data(), b"kernels");
        let (path, other) = (open().path, vk::PhysicalDeviceProperties { driver_version: 1, ..of });
        assert_ne!(KernelCache::open(folder.path(), &other).path.file_name(), path.file_name());
        for length in [0, 5, CHECKSUM, CHECKSUM + 3] {
            let bytes = fs::read(&path).expect("the file");
            fs::write(&path, &bytes[..length]).expect("written");
            assert_eq!(open().data(), b"", "{length} bytes");
            open().keep(b"kernels");
        }
        assert_eq!(open().data(), b"kernels");
        // A folder in its place is left alone.
        fs::remove_file(&path).and_then(|()| fs::create_dir(&path)).expect("a folder");
        open().keep(b"kernels");
        assert_eq!(open().data(), b"");
        // What cannot be written is no error.
        fs::write(folder.path().join("file"), "").expect("written");
        KernelCache::open(&folder.path().join("file"), &of).keep(b"kernels");
    }

    #[test]
    fn a_device_keeps_its_kernels() {
        let folder = tempfile::tempdir().expect("a folder");
        let options = DeviceOptions::default().validation(true).kernel_cache(Some(folder.path().to_owned()));
        for _ in 0..2 {
            let device = Device::new(&options).expect("a device");
            let log = device.validation_log();
            Pipeline::new(&device, &engine_kernel("combine"), 2, 12, &[]).expect("compiled");
            drop(device);
            assert_eq!(log.messages(), Vec::<String>::new());
            let files = files(folder.path());
            assert_eq!(files.len(), 1, "{files:?}");
            // The header of Vulkan at least, with its length at the start.
            let data = checked(fs::read(&files[0]).expect("the file")).expect("intact");
            assert!(data.len() >= 32 && data[..4] == 32u32.to_ne_bytes());
        }
    }
}
