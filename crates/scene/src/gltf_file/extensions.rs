//! What becomes of the extensions that a glTF file uses.

/// Extensions that are read. Where a texture needs a picture of another kind, the reader of materials says so.
const READ: [&str; 8] = [
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_mesh_quantization",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "MSFT_texture_dds",
];
/// Checks that a file does not require what is not read.
///
/// # Errors
/// Names the extension, and the remedy.
pub(super) fn check(required: &[String]) -> Result<(), String> {
    match required.iter().find(|name| !READ.contains(&name.as_str())) {
        Some(name) if name.contains("compression") => Err(format!(
            "its meshes are compressed ({name}), which is not read: export it without compression, or with EXT_meshopt_compression"
        )),
        Some(name) => Err(format!("it requires {name}, which is not read: export it without")),
        None => Ok(()),
    }
}
