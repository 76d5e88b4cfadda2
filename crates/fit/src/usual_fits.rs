//! What a job of photographs fits if it does not say.

use super::detect::{Candidate, candidates, pixels};
use super::parameters::{Fit, Per};
use super::target::Target;
use antirad_render::render::Quantity;
use antirad_scene::{Mesh, Scene};

/// A fit of the emission of all that may be a lamp, starting from 1 W/(m² sr).
pub(super) fn lamps(found: Vec<Candidate>) -> Fit {
    let groups = found.into_iter().map(|candidate| (candidate.name, candidate.triangles)).collect();
    Fit::new(Quantity::Emission).groups(Some(groups)).initial(Some([1.0; 3]))
}

/// Says what may be a lamp.
pub(super) fn say_lamps(found: &[Candidate]) -> String {
    let list = |seen: bool| {
        let of = found.iter().filter(|candidate| candidate.is_seen == seen);
        of.map(|c| format!("{} ({} triangles)", c.name, c.triangles.len())).collect::<Vec<_>>().join(", ")
    };
    let [seen, unseen] = [true, false].map(list);
    let hidden =
        if unseen.is_empty() { String::new() } else { format!("; as no picture shows them: {unseen}") };
    format!("Candidates for lamps, whose emission is fitted: as they are bright: {seen}{hidden}.")
}

/// Columns and rows of a texture, at least and at most.
const SIDES: [u32; 2] = [64, 512];
/// Pixels for each texel above which a texture over an atlas has twice the columns and rows.
const MANY: u32 = 32;

/// Lamps and albedos of a scene, and what is assumed, in whole sentences: the emission of what emits or, where nothing does, of what may be a
/// lamp; a texture for each mesh that has texture coordinates, or is alone, lamps apart; one albedo for each other one, or for each segment of others, and for each
/// triangle where one mesh alone has no room in a texture.
pub(super) fn usual_fits(scene: &Scene, targets: &[Target]) -> Result<(Vec<Fit>, Vec<String>), String> {
    let mut assumed = Vec::new();
    let emits = |t: usize| scene.material(t).emits();
    let mut emitters: Vec<String> =
        (0..scene.triangles.len()).filter(|&t| emits(t)).map(|t| scene.material(t).name.clone()).collect();
    emitters.sort();
    emitters.dedup();
    let mut may_shine: Vec<bool> = (0..scene.triangles.len()).map(emits).collect();
    let light = if emitters.is_empty() {
        let found = candidates(scene, targets);
        if found.is_empty() {
            return Err(String::from(
                "no [[fit]], and nothing in the pictures is bright enough to be a lamp: say what to fit",
            ));
        }
        found.iter().flat_map(|lamp| &lamp.triangles).for_each(|&t| may_shine[t as usize] = true);
        assumed.push(say_lamps(&found));
        lamps(found)
    } else {
        assumed.push(format!(
            "No [[fit]]: the emission of each of these materials is fitted: {}.",
            emitters.join(", ")
        ));
        Fit::new(Quantity::Emission).materials(Some(emitters))
    };
    let mut fits = vec![light];
    let meshes: Vec<&Mesh> = scene.meshes.iter().filter(|mesh| !mesh.range.is_empty()).collect();
    let is_mapped = |mesh: &&&Mesh| mesh.range.clone().all(|t| scene.patterns.uvs(t as usize).is_some());
    let (mapped, plain): (Vec<&Mesh>, Vec<&Mesh>) = meshes.iter().partition(is_mapped);
    let names = |meshes: &[&Mesh]| meshes.iter().map(|mesh| mesh.name.clone()).collect::<Vec<_>>();
    if !mapped.is_empty() {
        let names = names(&mapped);
        assumed.push(format!(
            "No [[fit]]: meshes with texture coordinates get a texture of 64 x 64 texels: {}.",
            names.join(", ")
        ));
        fits.push(Fit::new(Quantity::Albedo).per(Per::Texel).meshes(Some(names)));
    }
    // Where objects are meshes of their own, one albedo each is enough to start with, and quicker by far.
    let is_segmented = targets.iter().any(|target| target.labels.is_some());
    let alone =
        if let ([mesh], 1, false) = (&plain[..], meshes.len(), is_segmented) { Some(*mesh) } else { None };
    if let Some((mesh, atlas)) = alone.and_then(|mesh| Some((mesh, atlas(scene, mesh, targets, &may_shine)?)))
    {
        let (side, name) = (atlas.side, &mesh.name);
        assumed.push(format!(
            "No [[fit]]: the mesh has no texture coordinates; it gets some, and a texture: {name} ({side} x {side})."
        ));
        let on = |name: String, triangles| Fit::new(Quantity::Albedo).groups(Some(vec![(name, triangles)]));
        fits.push(on(name.clone(), atlas.triangles).per(Per::Texel).resolution(Some(side)));
        if !atlas.lamps.is_empty() {
            fits.push(on(format!("lamps of {name}"), atlas.lamps).per(Per::Mesh));
        }
    } else if !plain.is_empty() {
        let (per, each) = match (is_segmented, alone) {
            (true, _) => (Per::Segment, "segment of other meshes"),
            (false, Some(_)) => (Per::Triangle, "triangle"),
            (false, None) => (Per::Mesh, "other mesh"),
        };
        let remedy = if is_segmented { "" } else { " `objects = true` of a mesh tells its objects apart." };
        assumed.push(format!("No [[fit]]: each {each} has one albedo.{remedy}"));
        fits.push(Fit::new(Quantity::Albedo).per(per).meshes(Some(names(&plain))));
    }
    Ok((fits, assumed))
}

/// A texture over an atlas of a mesh.
struct Atlas {
    /// Columns and rows.
    side: u32,
    triangles: Vec<u32>,
    /// Triangles that it leaves out.
    lamps: Vec<u32>,
}

/// The usual atlas of a mesh, given which triangles may be lamps; `None` where a texture would show no more than an albedo for each triangle.
fn atlas(scene: &Scene, mesh: &Mesh, targets: &[Target], may_shine: &[bool]) -> Option<Atlas> {
    let (lamps, triangles): (Vec<u32>, Vec<u32>) = mesh.range.clone().partition(|&t| may_shine[t as usize]);
    let shown = pixels(scene, targets);
    let pixels: u32 = triangles.iter().map(|&t| shown[t as usize]).sum();
    if pixels == 0 {
        return None;
    }
    let [least, most] = SIDES;
    let seen = std::iter::successors(Some(least), |side| Some(2 * side))
        .find(|side| *side >= most || MANY * side * side >= pixels);
    // Surfaces in many small charts need the more texels.
    let side = seen.unwrap_or(most).max(2 * scene.least_atlas(&triangles));
    (side <= most).then_some(Atlas { side, triangles, lamps })
}
