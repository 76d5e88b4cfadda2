//! The buffers of a glTF file, and what its addresses refer to.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use data_url::DataUrl;
use percent_encoding::percent_decode_str;

use super::meshopt::Compressed;

/// Most bytes of a file, and of all views that are decompressed.
pub(super) const MOST_BYTES: u64 = 1 << 31;

/// The bytes of a file's buffer views.
pub(super) struct Buffers {
    buffers: Vec<Vec<u8>>,
    /// Bytes of compressed views, by index.
    decompressed: HashMap<usize, Vec<u8>>,
}

impl Buffers {
    /// Fetches all buffers that something reads, and decompresses views.
    ///
    /// # Errors
    /// Fails if a buffer is missing or too short, or if compressed data are malformed. The error says what is wrong, without the file.
    pub fn read(document: &gltf::Document, blob: Option<Vec<u8>>, path: &Path) -> Result<Self, String> {
        let mut compressed = Vec::new();
        let mut needed = HashSet::new();
        for view in document.views() {
            let extension = Compressed::of(&view)?;
            // The buffer of a compressed view is for programs that do not decompress it, and may not exist.
            needed.insert(extension.as_ref().map_or(view.buffer().index(), |extension| extension.buffer));
            compressed.extend(extension.map(|extension| (view.index(), extension)));
        }
        let mut blob = blob;
        let mut read = Self { buffers: Vec::new(), decompressed: HashMap::new() };
        for buffer in document.buffers() {
            let bytes = match buffer.source() {
                _ if !needed.contains(&buffer.index()) => Vec::new(),
                gltf::buffer::Source::Bin => {
                    blob.take().ok_or("refers to binary data that it does not contain; is it a .glb?")?
                }
                gltf::buffer::Source::Uri(uri) => fetch(uri, path, MOST_BYTES)?,
            };
            if needed.contains(&buffer.index()) && bytes.len() < buffer.length() {
                return Err(format!(
                    "buffer {} has {} bytes, of {} that it should have",
                    buffer.index(),
                    bytes.len(),
                    buffer.length()
                ));
            }
            read.buffers.push(bytes);
        }
        let mut all = 0;
        for (index, view) in compressed.iter().filter(|(_, view)| !view.is_direction()) {
            let wrong = |what: &str| format!("buffer view {index} (EXT_meshopt_compression) {what}");
            let length = view.decoded_length().map_or(u64::MAX, |length| length as u64);
            all = length.saturating_add(all);
            if all > MOST_BYTES {
                return Err(wrong(&format!("makes more than {MOST_BYTES} bytes")));
            }
            let data = read.slice(view.buffer, view.byte_offset, view.byte_length);
            let bytes = data.and_then(|data| view.decode(data));
            read.decompressed.insert(*index, bytes.ok_or_else(|| wrong("has malformed data"))?);
        }
        Ok(read)
    }

    /// The bytes of a view, or `None` if it reaches past the end of its buffer.
    pub fn view(&self, view: &gltf::buffer::View) -> Option<&[u8]> {
        match self.decompressed.get(&view.index()) {
            Some(bytes) => Some(bytes),
            None => self.slice(view.buffer().index(), view.offset(), view.length()),
        }
    }

    fn slice(&self, buffer: usize, offset: usize, length: usize) -> Option<&[u8]> {
        self.buffers.get(buffer)?.get(offset..offset.checked_add(length)?)
    }
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
