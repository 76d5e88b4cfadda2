//! Scenes of Mitsuba 3.

use super::ply;
use antirad_base::output::{OutputError, atomic_write};
use antirad_scene::{Camera, Material, Scene, Sun};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

pub fn write(scene: &Scene, path: &Path) -> Result<(), OutputError> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut text = String::from("<scene version=\"3.0.0\">\n    <integrator type=\"path\"/>\n");
    scene.cameras.iter().for_each(|camera| text += &sensor(camera));
    scene.suns.iter().for_each(|sun| text += &directional(sun));
    let used: std::collections::BTreeSet<u32> = scene.triangles.iter().map(|t| t.material).collect();
    for &index in &used {
        text += &bsdf(index, &scene.materials[index as usize]);
    }
    let mut number = 0;
    let sheet = sheets(scene);
    for mesh in &scene.meshes {
        let mut alike: BTreeMap<(u32, bool), Vec<usize>> = BTreeMap::new();
        for t in mesh.range.clone().map(|t| t as usize) {
            if sheet[t] != Some(Side::Second) {
                alike.entry((scene.triangles[t].material, sheet[t].is_some())).or_default().push(t);
            }
        }
        for ((index, two_sided), triangles) in alike {
            number += 1;
            let file = format!("{stem}_{number}.ply");
            ply::write(scene, &path.with_file_name(&file), &triangles, None)?;
            text += &shape(&mesh.name, &file, index, &scene.materials[index as usize], two_sided);
        }
    }
    text += "</scene>\n";
    atomic_write(path, |output| output.write_all(text.as_bytes()))
}

/// A side of a sheet.
#[derive(Clone, Copy, PartialEq)]
enum Side {
    First,
    Second,
}

/// The triangles whose other side has their material, and does not shine. Mitsuba meets either of two triangles in one place, so that sheets
/// are one there, with a BSDF of two sides.
fn sheets(scene: &Scene) -> Vec<Option<Side>> {
    let other = scene.other_sides();
    let side = |t: usize| {
        let back = other[t]? as usize;
        let alike = scene.triangles[t].material == scene.triangles[back].material;
        let shines = scene.material(t).emits();
        (alike && !shines && other[back] == Some(t as u32)).then_some(if t < back {
            Side::First
        } else {
            Side::Second
        })
    };
    (0..other.len()).map(side).collect()
}

fn rgb(name: &str, [r, g, b]: [f64; 3]) -> String {
    format!("<rgb name=\"{name}\" value=\"{r:?} {g:?} {b:?}\"/>")
}

fn escaped(text: &str) -> String {
    text.chars().fold(String::new(), |mut escaped, c| {
        match c {
            '<' | '>' | '&' | '"' | '\'' => write!(escaped, "&#{};", c as u32).unwrap_or(()),
            c if c.is_control() => escaped.push('_'),
            c => escaped.push(c),
        }
        escaped
    })
}

/// Surfaces have one side there as here. A lobe of power p is about as wide as microfacets of roughness α = √(2/(p + 2)).
fn bsdf(index: u32, material: &Material) -> String {
    let name = escaped(&material.name);
    let albedo = material.diffuse_albedo();
    let alpha = (2.0 / (material.power + 2.0)).sqrt().clamp(0.01, 1.0);
    let inner = match (material.is_glossy(), albedo == [0.0; 3]) {
        (false, _) => format!("<bsdf type=\"diffuse\" id=\"m{index}\">{}", rgb("reflectance", albedo)),
        (true, true) => format!(
            "<bsdf type=\"roughconductor\" id=\"m{index}\"><string name=\"material\" value=\"none\"/><float name=\"alpha\" \
             value=\"{alpha:?}\"/>{}",
            rgb("specular_reflectance", material.specular.map(|s| s.min(1.0)))
        ),
        (true, false) => format!(
            "<bsdf type=\"roughplastic\" id=\"m{index}\"><float name=\"alpha\" value=\"{alpha:?}\"/>{}",
            rgb("diffuse_reflectance", albedo)
        ),
    };
    format!("    <!-- {} -->\n    {inner}</bsdf>\n", name.replace("--", "__"))
}

fn shape(mesh: &str, file: &str, index: u32, material: &Material, two_sided: bool) -> String {
    let bsdf = format!("<ref id=\"m{index}\"/>");
    let bsdf = if two_sided { format!("<bsdf type=\"twosided\">{bsdf}</bsdf>") } else { bsdf };
    let lamp = if !material.emits() {
        String::new()
    } else {
        format!("        <emitter type=\"area\">{}</emitter>\n", rgb("radiance", material.emission))
    };
    format!(
        "    <shape type=\"ply\" id=\"{} {}\">\n        <string name=\"filename\" value=\"{}\"/>\n        <boolean \
         name=\"face_normals\" value=\"true\"/>\n        {bsdf}\n{lamp}    </shape>\n",
        escaped(mesh),
        escaped(&material.name),
        escaped(file)
    )
}

/// All light of a sun comes from its middle there.
fn directional(sun: &Sun) -> String {
    let [x, y, z] = sun.travels().to_array();
    format!(
        "    <emitter type=\"directional\"><vector name=\"direction\" value=\"{x:?}, {y:?}, {z:?}\"/>{}</emitter>\n",
        rgb("irradiance", sun.irradiance)
    )
}

fn sensor(camera: &Camera) -> String {
    let point = |v: glam::DVec3| format!("{:?}, {:?}, {:?}", v.x, v.y, v.z);
    format!(
        "    <sensor type=\"perspective\" id=\"{}\">\n        <float name=\"fov\" value=\"{:?}\"/>\n        <string name=\"fov_axis\" \
         value=\"x\"/>\n        <transform name=\"to_world\"><lookat origin=\"{}\" target=\"{}\" up=\"{}\"/></transform>\n        <film \
         type=\"hdrfilm\"><integer name=\"width\" value=\"{}\"/><integer name=\"height\" value=\"{}\"/><rfilter \
         type=\"box\"/></film>\n        <sampler type=\"independent\"><integer name=\"sample_count\" value=\"64\"/></sampler>\n    \
         </sensor>\n",
        escaped(&camera.name),
        camera.fov_x_degrees,
        point(camera.position),
        point(camera.target),
        point(camera.up),
        camera.width,
        camera.height
    )
}
