//! Selects the triangles, vertices or views of a [`Fit`], and groups those that share a value.

use super::parameters::{Fit, Groups, MotionKind, ParameterError, Per};
use antirad_render::render::Quantity;
use antirad_scene::{Scene, Welded, nearest};
use std::collections::HashMap;

/// The selection of a [`Fit`].
#[derive(Debug)]
pub(super) struct Selected {
    /// Groups with a name and the triangles (for positions vertices, for cameras views) that share a value. Groups are disjoint.
    pub groups: Groups,
    /// Mean length of the selected edges, m; 1 if there are none.
    pub edge: f64,
}

/// Selects; the error says what is wrong.
pub(super) fn select(scene: &Scene, fit: &Fit) -> Result<Selected, String> {
    if fit.quantity == Quantity::Camera {
        return views(scene, fit);
    }
    if fit.cameras.is_some() {
        let word = fit.quantity.word();
        return Err(format!("{word} is not of cameras: use `materials` or `meshes` instead of `cameras`"));
    }
    let materials = indices("material", &fit.materials, scene.materials.iter().map(|m| m.name.as_str()))?;
    let meshes = indices("mesh", &fit.meshes, scene.meshes.iter().map(|m| m.name.as_str()))?;
    if fit.quantity == Quantity::Position {
        if materials.is_some() {
            return Err(String::from("a position belongs to a mesh: use `meshes` instead of `materials`"));
        }
        return vertices(scene, fit, meshes);
    }
    let picked = |at: &Option<Vec<usize>>, index: usize| at.as_ref().is_none_or(|at| at.contains(&index));
    let is_picked = |mesh: usize, t: u32| {
        picked(&meshes, mesh) && picked(&materials, scene.triangles[t as usize].material as usize)
    };
    if let Some(groups) = &fit.groups {
        let beyond = groups.iter().flat_map(|(_, of)| of).find(|t| **t as usize >= scene.triangles.len());
        if let Some(t) = beyond {
            return Err(format!("there is no triangle {t}: the scene has {}", scene.triangles.len()));
        }
        let mut groups = groups.clone();
        if meshes.is_some() || materials.is_some() {
            let mesh_of = |t: u32| scene.meshes.iter().position(|mesh| mesh.range.contains(&t));
            let is_picked = |t: &u32| mesh_of(*t).is_some_and(|mesh| is_picked(mesh, *t));
            groups.iter_mut().for_each(|(_, of)| of.retain(is_picked));
            groups.retain(|(_, of)| !of.is_empty());
        }
        return selected(groups);
    }
    if fit.per == Per::Segment {
        return Err(String::from(
            "per = \"segment\" needs labels of pixels: add segments = \"seg/{name}.png\" to a [[target]] of photographs",
        ));
    }
    let mut groups: Groups = Vec::new();
    let mut group_of: HashMap<usize, usize> = HashMap::new();
    for (mesh, range) in scene.meshes.iter().map(|m| m.range.clone()).enumerate() {
        for t in range.filter(|&t| is_picked(mesh, t)) {
            let material = scene.triangles[t as usize].material as usize;
            let (key, name): (_, &dyn Fn() -> String) = match fit.per {
                Per::Material => (material, &|| scene.materials[material].name.clone()),
                Per::Mesh | Per::Segment | Per::Texel => (mesh, &|| scene.meshes[mesh].name.clone()),
                Per::Triangle => (t as usize, &|| format!("triangle {t}")),
            };
            let group = *group_of.entry(key).or_insert_with(|| {
                groups.push((name(), Vec::new()));
                groups.len() - 1
            });
            groups[group].1.push(t);
        }
    }
    selected(groups)
}

/// A selection of triangles, unless it is empty.
fn selected(groups: Groups) -> Result<Selected, String> {
    match groups.is_empty() {
        true => Err(String::from("no triangle has both a given material and a given mesh; choose others")),
        false => Ok(Selected { groups, edge: 1.0 }),
    }
}

fn vertices(scene: &Scene, fit: &Fit, meshes: Option<Vec<usize>>) -> Result<Selected, String> {
    let meshes = meshes.unwrap_or_else(|| (0..scene.meshes.len()).collect());
    let used = |mesh: usize| {
        let range = scene.meshes[mesh].range.clone();
        let mut used: Vec<u32> = scene.triangles[range.start as usize..range.end as usize]
            .iter()
            .flat_map(|t| t.vertices)
            .collect();
        used.sort_unstable();
        used.dedup();
        used
    };
    let mut groups: Groups = Vec::new();
    if fit.motion == MotionKind::Vertices {
        let mut all: Vec<u32> = meshes.iter().flat_map(|&mesh| used(mesh)).collect();
        all.sort_unstable();
        all.dedup();
        // Vertices at the same place are one corner written twice: moving them apart would tear the surface.
        let welded = Welded::exactly(all.iter().map(|&v| scene.vertices[v as usize]));
        groups.extend(welded.first.iter().map(|&at| (format!("vertex {}", all[at as usize]), Vec::new())));
        for (v, position) in all.into_iter().zip(welded.position) {
            groups[position as usize].1.push(v);
        }
    } else if fit.together {
        let name = meshes.iter().map(|&m| scene.meshes[m].name.as_str()).collect::<Vec<_>>().join(" + ");
        let mut all: Vec<u32> = meshes.iter().flat_map(|&mesh| used(mesh)).collect();
        all.sort_unstable();
        all.dedup();
        groups.push((name, all));
    } else {
        groups.extend(meshes.iter().map(|&mesh| (scene.meshes[mesh].name.clone(), used(mesh))));
    }
    groups.retain(|(_, vertices)| !vertices.is_empty());
    if groups.is_empty() {
        return Err(String::from("these meshes have no vertices; choose others"));
    }
    let mut edges = (0.0, 0u32);
    for &mesh in &meshes {
        let range = scene.meshes[mesh].range.clone();
        for t in range {
            let [a, b, c] = scene.corners(t as usize);
            edges.0 += (b - a).length() + (c - b).length() + (a - c).length();
            edges.1 += 3;
        }
    }
    let edge = edges.0 / f64::from(edges.1);
    Ok(Selected { groups, edge: if edge > 0.0 { edge } else { 1.0 } })
}

/// Views of equal cameras are views of one.
fn views(scene: &Scene, fit: &Fit) -> Result<Selected, String> {
    for (key, given) in [("materials", &fit.materials), ("meshes", &fit.meshes)] {
        if given.is_some() {
            return Err(format!("a camera belongs to a target: use `cameras` instead of `{key}`"));
        }
    }
    let named = |name: &str| fit.cameras.as_ref().is_none_or(|names| names.iter().any(|n| n == name));
    let known = scene.cameras.iter().map(|camera| camera.name.as_str());
    for name in fit.cameras.iter().flatten() {
        if !known.clone().any(|known| known == name) {
            return Err(unknown_of("no target has the camera", name, "they have", known));
        }
    }
    let chosen = || (0..).zip(&scene.cameras).filter(|(_, camera)| named(&camera.name));
    if fit.together {
        if fit.motion == MotionKind::Vertices {
            return Err(String::from(
                "cameras that move together have motion = \"similarity\", \"rigid\", \"translation\" or \"scale\"",
            ));
        }
        let views: Vec<u32> = chosen().map(|(view, _)| view).collect();
        let mut groups = fit.groups.clone().unwrap_or_else(|| vec![(String::from("cameras"), views.clone())]);
        groups.iter_mut().for_each(|(_, of)| of.retain(|view| views.contains(view)));
        groups.retain(|(_, of)| !of.is_empty());
        return some_cameras(groups);
    }
    let mut groups: Groups = Vec::new();
    for (view, camera) in chosen() {
        let same = |(_, views): &&mut (String, Vec<u32>)| scene.cameras[views[0] as usize] == *camera;
        match groups.iter_mut().find(same) {
            Some((_, views)) => views.push(view),
            None => groups.push((camera.name.clone(), vec![view])),
        }
    }
    some_cameras(groups)
}

/// A selection of cameras, unless it is empty.
fn some_cameras(groups: Groups) -> Result<Selected, String> {
    match groups.is_empty() {
        true => Err(String::from("no camera is selected; name one of a target")),
        false => Ok(Selected { groups, edge: 1.0 }),
    }
}

/// Indices of names; an unknown name is an error that suggests the closest.
fn indices<'a>(
    what: &str,
    names: &Option<Vec<String>>,
    known: impl Iterator<Item = &'a str> + Clone,
) -> Result<Option<Vec<usize>>, String> {
    let Some(names) = names else { return Ok(None) };
    let index = |name: &String| {
        known.clone().position(|k| k == name).ok_or_else(|| unknown(what, name, known.clone()))
    };
    names.iter().map(index).collect::<Result<_, _>>().map(Some)
}

/// The message for an unknown name.
pub(super) fn unknown<'a>(what: &str, name: &str, known: impl Iterator<Item = &'a str> + Clone) -> String {
    unknown_of(&format!("the scene has no {what}"), name, "it has", known)
}

/// The message for a name that none of those known is.
pub(super) fn unknown_of<'a>(
    there_is_no: &str,
    name: &str,
    there_are: &str,
    known: impl Iterator<Item = &'a str> + Clone,
) -> String {
    match nearest(name, known.clone()) {
        Some(near) => format!("{there_is_no} \"{name}\"; did you mean \"{near}\"?"),
        None => {
            // A scene may have as many materials as triangles.
            let mut list: Vec<&str> = known.take(21).collect();
            if list.len() > 20 {
                list[20] = "…";
            }
            format!("{there_is_no} \"{name}\"; {there_are}: {}", list.join(", "))
        }
    }
}

/// Rejects values fitted twice, and fits of both δ and ρ, which act only through their product.
pub(super) fn check_overlaps(
    scene: &Scene,
    fits: &[Fit],
    selected: &[Selected],
) -> Result<(), ParameterError> {
    let mut taken: HashMap<(Quantity, u32), usize> = HashMap::new();
    for (fit, (what, selected)) in fits.iter().zip(selected).enumerate() {
        for member in selected.groups.iter().flat_map(|(_, members)| members) {
            let refuse = |message: String| Err(ParameterError { fit, message });
            let of = match what.quantity {
                Quantity::Position => "vertex",
                Quantity::Camera => "target",
                _ => "triangle",
            };
            let word = what.quantity.word();
            match taken.insert((what.quantity, *member), fit) {
                Some(first) if first != fit => {
                    return refuse(format!(
                        "{word} of {of} {member} is fitted twice; leave it out of one [[fit]]"
                    ));
                }
                Some(_) => {
                    return refuse(format!(
                        "{of} {member} belongs to two meshes that move separately; set `together`"
                    ));
                }
                None => {}
            }
            let other = match what.quantity {
                Quantity::Albedo => Quantity::Diffuse,
                Quantity::Diffuse => Quantity::Albedo,
                _ => continue,
            };
            if taken.contains_key(&(other, *member)) {
                let material = &scene.material(*member as usize).name;
                return refuse(format!(
                    "albedo and diffuse of material \"{material}\" act only through their product, so that not both can \
                     be found; fit one"
                ));
            }
        }
    }
    Ok(())
}

/// Per triangle, a label for [`Scene::split_materials`]: triangles differ in label if some fit distinguishes them.
pub(super) fn labels(scene: &Scene, fits: &[Fit], selected: &[Selected]) -> Vec<u64> {
    let mut labels = vec![0u64; scene.triangles.len()];
    // Members of other fits are vertices or views; such fits do not distinguish triangles.
    let of_triangles = |fit: &Fit| !matches!(fit.quantity, Quantity::Position | Quantity::Camera);
    let of_materials = fits.iter().zip(selected).filter(|(fit, _)| of_triangles(fit));
    for (fit, selected) in of_materials {
        let mut group_of = vec![0u64; scene.triangles.len()];
        for ((_, members), group) in selected.groups.iter().zip(1..) {
            for &t in members {
                // Of a texture, each triangle has its own mean.
                group_of[t as usize] = if fit.per == Per::Texel { 1 + u64::from(t) } else { group };
            }
        }
        let mut pairs: HashMap<(u64, u64), u64> = HashMap::new();
        for (label, group) in labels.iter_mut().zip(group_of) {
            let next = pairs.len() as u64;
            *label = *pairs.entry((*label, group)).or_insert(next);
        }
    }
    labels
}
