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

/// The albedos that are fitted of one mesh.
enum Albedo {
    /// A texture over its texture coordinates.
    Mapped,
    /// A texture of such columns and rows over an atlas of all triangles but lamps.
    Atlas(u32, Vec<u32>),
    /// One value.
    Even,
}

/// Lamps and albedos of a scene, and what is assumed, in whole sentences: the emission of what emits or, where nothing does, of what may be a
/// lamp; a texture for each mesh that has texture coordinates, or is alone, lamps apart; one albedo for each other one, and for each
/// triangle where one mesh alone has no room in a texture.
pub(super) fn usual_fits(scene: &Scene, targets: &[Target]) -> Result<(Vec<Fit>, Vec<String>), String> {
    let mut assumed = Vec::new();
    let emits = |t: usize| scene.material(t).emission != [0.0; 3];
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
    let shown = pixels(scene, targets);
    let meshes: Vec<&Mesh> = scene.meshes.iter().filter(|mesh| !mesh.range.is_empty()).collect();
    let albedos: Vec<Albedo> =
        meshes.iter().map(|mesh| albedo(scene, mesh, meshes.len() == 1, &shown, &may_shine)).collect();
    let of = || meshes.iter().zip(&albedos);

    let mut fits = vec![light];
    let mapped: Vec<String> = of()
        .filter(|(_, albedo)| matches!(albedo, Albedo::Mapped))
        .map(|(mesh, _)| mesh.name.clone())
        .collect();
    if !mapped.is_empty() {
        assumed.push(format!(
            "No [[fit]]: meshes with texture coordinates get a texture of 64 x 64 texels: {}.",
            mapped.join(", ")
        ));
        fits.push(Fit::new(Quantity::Albedo).per(Per::Texel).meshes(Some(mapped)));
    }
    let mut sizes = Vec::new();
    for (mesh, albedo) in of() {
        if let Albedo::Atlas(side, triangles) = albedo {
            let groups = Some(vec![(mesh.name.clone(), triangles.clone())]);
            fits.push(Fit::new(Quantity::Albedo).per(Per::Texel).resolution(Some(*side)).groups(groups));
            sizes.push(format!("{} ({side} x {side})", mesh.name));
        }
    }
    if !sizes.is_empty() {
        assumed.push(format!(
            "No [[fit]]: the mesh has no texture coordinates; it gets some, and a texture: {}.",
            sizes.join(", ")
        ));
    }
    let plain: Vec<String> = of()
        .filter(|(_, albedo)| matches!(albedo, Albedo::Even))
        .map(|(mesh, _)| mesh.name.clone())
        .collect();
    if !plain.is_empty() {
        let alone = scene.meshes.len() == 1;
        let (per, each) = if alone { (Per::Triangle, "triangle") } else { (Per::Mesh, "other mesh") };
        assumed.push(format!(
            "No [[fit]]: each {each} has one albedo. `objects = true` of a mesh tells its objects apart."
        ));
        fits.push(Fit::new(Quantity::Albedo).per(per).meshes(Some(plain)));
    }
    // What an atlas leaves out.
    let lamps_of = |mesh: &Mesh| mesh.range.clone().filter(|&t| may_shine[t as usize]).collect::<Vec<u32>>();
    let left: Vec<(String, Vec<u32>)> = of()
        .filter(|(_, albedo)| matches!(albedo, Albedo::Atlas(..)))
        .map(|(mesh, _)| (format!("lamps of {}", mesh.name), lamps_of(mesh)))
        .filter(|(_, lamps)| !lamps.is_empty())
        .collect();
    if !left.is_empty() {
        fits.push(Fit::new(Quantity::Albedo).per(Per::Mesh).groups(Some(left)));
    }
    Ok((fits, assumed))
}

/// The usual albedos of a mesh, given whether there is no other, the pixels that show each triangle, and which triangles may be lamps. Where
/// objects are meshes of their own, one albedo each is enough to start with, and quicker by far.
fn albedo(scene: &Scene, mesh: &Mesh, is_alone: bool, shown: &[u32], may_shine: &[bool]) -> Albedo {
    if mesh.range.clone().all(|t| scene.patterns.uvs(t as usize).is_some()) {
        return Albedo::Mapped;
    }
    let triangles: Vec<u32> = mesh.range.clone().filter(|&t| !may_shine[t as usize]).collect();
    let pixels: u32 = triangles.iter().map(|&t| shown[t as usize]).sum();
    if !is_alone || pixels == 0 || triangles.is_empty() {
        return Albedo::Even;
    }
    let [least, most] = SIDES;
    let seen = std::iter::successors(Some(least), |side| Some(2 * side))
        .find(|side| *side >= most || MANY * side * side >= pixels);
    // Of a surface in many small charts a texture shows no more than an albedo for each triangle.
    let side = seen.unwrap_or(most).max(2 * scene.least_atlas(&triangles));
    if side <= most { Albedo::Atlas(side, triangles) } else { Albedo::Even }
}
