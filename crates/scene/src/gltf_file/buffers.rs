//! The buffers of a glTF file, and what its addresses refer to.

use std::path::{Path, PathBuf};

use data_url::DataUrl;
use percent_encoding::percent_decode_str;

/// Most bytes of a file.
pub(super) const MOST_BYTES: u64 = 1 << 31;

/// All buffers, by index. The error says what is wrong.
pub(super) fn read(
    document: &gltf::Document,
    blob: Option<Vec<u8>>,
    path: &Path,
) -> Result<Vec<Vec<u8>>, String> {
    let mut blob = blob;
    let mut buffers = Vec::new();
    for buffer in document.buffers() {
        let bytes = match buffer.source() {
            gltf::buffer::Source::Bin => {
                blob.take().ok_or("refers to binary data that it does not contain; is it a .glb?")?
            }
            gltf::buffer::Source::Uri(uri) => fetch(uri, path, MOST_BYTES)?,
        };
        if bytes.len() < buffer.length() {
            return Err(format!(
                "buffer {} has {} bytes, of {} that it should have",
                buffer.index(),
                bytes.len(),
                buffer.length()
            ));
        }
        buffers.push(bytes);
    }
    Ok(buffers)
}

/// The bytes at an address: data in it, or a file beside the glTF.
pub(super) fn fetch(uri: &str, path: &Path, most: u64) -> Result<Vec<u8>, String> {
    if uri.starts_with("data:") {
        let url =
            DataUrl::process(uri).map_err(|error| format!("an address of data is malformed: {error:?}"))?;
        let (bytes, _) =
            url.decode_to_vec().map_err(|error| format!("data in an address is malformed: {error:?}"))?;
        return Ok(bytes);
    }
    let file = beside(uri, path)?;
    antirad_base::input::read_at_most(&file, most)
        .map_err(|reason| format!("{} cannot be read: {reason}", file.display()))
}

fn beside(uri: &str, path: &Path) -> Result<PathBuf, String> {
    if uri.contains("://") {
        return Err(format!("`{uri}` is an address on a network; put the file beside this one"));
    }
    let name =
        percent_decode_str(uri).decode_utf8().map_err(|_| format!("the address `{uri}` is not in UTF-8"))?;
    Ok(path.parent().unwrap_or(Path::new("")).join(&*name))
}
