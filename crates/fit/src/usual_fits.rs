//! What a job of photographs fits if it does not say.

use super::detect::{Candidate, candidates};
use super::parameters::{Fit, Per};
use super::target::Target;
use antirad_render::render::Quantity;
use antirad_scene::Scene;

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

/// Lamps and albedos of a scene, and what is assumed, in whole sentences: the emission of what emits or, where nothing does, of what may be a
/// lamp; a texture for each mesh with texture coordinates, one albedo for each other one, and for each triangle if there is one mesh alone.
pub(super) fn usual_fits(scene: &Scene, targets: &[Target]) -> Result<(Vec<Fit>, Vec<String>), String> {
    let mut assumed = Vec::new();
    let emits = |t: usize| scene.material(t).emission != [0.0; 3];
    let mut emitters: Vec<String> =
        (0..scene.triangles.len()).filter(|&t| emits(t)).map(|t| scene.material(t).name.clone()).collect();
    emitters.sort();
    emitters.dedup();
    let light = if emitters.is_empty() {
        let found = candidates(scene, targets);
        if found.is_empty() {
            return Err(String::from(
                "no [[fit]], and nothing in the pictures is bright enough to be a lamp: say what to fit",
            ));
        }
        assumed.push(say_lamps(&found));
        lamps(found)
    } else {
        assumed.push(format!(
            "No [[fit]]: the emission of each of these materials is fitted: {}.",
            emitters.join(", ")
        ));
        Fit::new(Quantity::Emission).materials(Some(emitters))
    };
    let mapped = |range: std::ops::Range<u32>| {
        !range.is_empty() && range.into_iter().all(|t| scene.patterns.uvs(t as usize).is_some())
    };
    let (textured, plain): (Vec<_>, Vec<_>) =
        scene.meshes.iter().partition(|mesh| mapped(mesh.range.clone()));
    let names =
        |meshes: &[&antirad_scene::Mesh]| meshes.iter().map(|mesh| mesh.name.clone()).collect::<Vec<_>>();
    let mut fits = vec![light];
    if !textured.is_empty() {
        let names = names(&textured);
        let list = names.join(", ");
        assumed.push(format!(
            "No [[fit]]: meshes with texture coordinates get a texture of 64 x 64 texels: {list}."
        ));
        fits.push(Fit::new(Quantity::Albedo).per(Per::Texel).meshes(Some(names)));
    }
    if !plain.is_empty() {
        let alone = scene.meshes.len() == 1;
        let (per, each) = if alone { (Per::Triangle, "triangle") } else { (Per::Mesh, "other mesh") };
        assumed.push(format!(
            "No [[fit]]: each {each} has one albedo. `objects = true` of a mesh tells its objects apart."
        ));
        fits.push(Fit::new(Quantity::Albedo).per(per).meshes(Some(names(&plain))));
    }
    Ok((fits, assumed))
}
