//! What becomes of the extensions that a glTF file uses.

/// Extensions that are read. Where a texture needs a picture of another kind, the reader of materials says so.
const READ: [&str; 10] = [
    super::instancing::NAME,
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_mesh_quantization",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "MSFT_texture_dds",
];
/// Extensions without which the scene still has its shape, and what stands in for each.
const INSTEAD: [(&str, &str); 12] = [
    ("KHR_materials_anisotropy", "lobes are as wide in all directions"),
    ("KHR_materials_clearcoat", "surfaces have no coat"),
    ("KHR_materials_diffuse_transmission", "surfaces are opaque"),
    ("KHR_materials_dispersion", "surfaces are opaque"),
    ("KHR_materials_ior", "dielectrics reflect 4 % at normal incidence"),
    ("KHR_materials_iridescence", "lobes have one colour"),
    ("KHR_materials_sheen", "surfaces have no sheen"),
    ("KHR_materials_specular", "dielectrics reflect 4 % at normal incidence"),
    ("KHR_materials_transmission", "surfaces are opaque"),
    ("KHR_materials_unlit", "surfaces reflect light like others"),
    ("KHR_materials_variants", "the first variant is taken"),
    ("KHR_materials_volume", "surfaces are opaque"),
];

/// Checks that a file does not require what is not read.
///
/// # Errors
/// Names the extension, and the remedy.
pub(super) fn check(required: &[String]) -> Result<(), String> {
    let known = |name: &str| READ.contains(&name) || INSTEAD.iter().any(|&(other, _)| other == name);
    match required.iter().find(|name| !known(name)) {
        Some(name) if name.contains("compression") => Err(format!(
            "its meshes are compressed ({name}), which is not read: export it without compression, or with EXT_meshopt_compression"
        )),
        Some(name) => Err(format!("it requires {name}, which is not read: export it without")),
        None => Ok(()),
    }
}

/// What becomes of each extension that is used and not read.
pub(super) fn notes(used: &[String]) -> impl Iterator<Item = String> {
    let unread = used.iter().filter(|name| !READ.contains(&name.as_str()));
    unread.map(|name| match INSTEAD.iter().find(|(other, _)| other == name) {
        Some((_, instead)) => format!("{name} ({instead})"),
        None => name.clone(),
    })
}
