//! Triangles that segmentation pictures give the same label.

use super::first_hits::first_hits;
use super::parameters::Groups;
use super::target::Target;
use antirad_render::image::Label;
use antirad_scene::Scene;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Most labels of all pictures together: more are no segmentation by materials.
const MOST: usize = 256;

/// How many pixels show a triangle with a label.
type Votes = BTreeMap<(usize, Label), u32>;

/// Groups of triangles by label: each triangle has the one that most pixels which show it have, over all targets. What no labelled pixel
/// shows is a group for each mesh, at the end. `None` if no target has labels.
///
/// # Errors
/// Fails if there are more than 256 labels.
pub fn segments(scene: &Scene, targets: &[Target]) -> Result<Option<Groups>, String> {
    if targets.iter().all(|target| target.labels.is_none()) {
        return Ok(None);
    }
    check_number(targets.iter().filter_map(|target| target.labels.as_deref()).flatten())?;
    let label_of = majorities(&votes(scene, targets));
    let mut of_labels: BTreeMap<Label, Vec<u32>> = BTreeMap::new();
    let mut others = Vec::new();
    for mesh in &scene.meshes {
        let mut other = Vec::new();
        for t in mesh.range.clone() {
            match label_of.get(&(t as usize)) {
                Some(label) => of_labels.entry(*label).or_default().push(t),
                None => other.push(t),
            }
        }
        if !other.is_empty() {
            others.push((mesh.name.clone(), other));
        }
    }
    let of_labels = of_labels.into_iter().map(|(label, triangles)| (name(label), triangles));
    Ok(Some(of_labels.chain(others).collect()))
}

/// Fails if there are too many labels.
pub(super) fn check_number<'a>(labels: impl Iterator<Item = &'a Option<Label>>) -> Result<(), String> {
    let distinct: BTreeSet<Label> = labels.flatten().copied().collect();
    match distinct.len() <= MOST {
        true => Ok(()),
        false => Err(format!(
            "{} colours, but at most {MOST} labels; save segmentation as PNG, with one colour for each material, the same in all \
             pictures, and without smooth edges",
            distinct.len()
        )),
    }
}

fn votes(scene: &Scene, targets: &[Target]) -> Votes {
    let rays = scene.rays();
    let of_target = |target: &Target| {
        let mut votes = Votes::new();
        if let Some(labels) = &target.labels {
            for (at, triangle) in first_hits(&rays, target) {
                if let Some(label) = labels[at] {
                    *votes.entry((triangle, label)).or_default() += 1;
                }
            }
        }
        votes
    };
    let added = |mut all: Votes, more: Votes| {
        more.into_iter().for_each(|(vote, pixels)| *all.entry(vote).or_default() += pixels);
        all
    };
    targets.par_iter().map(of_target).reduce(Votes::new, added)
}

/// The label of each triangle that has votes: of those with most of them the first.
fn majorities(votes: &Votes) -> BTreeMap<usize, Label> {
    let mut best: BTreeMap<usize, (u32, Label)> = BTreeMap::new();
    for (&(triangle, label), &pixels) in votes {
        let most = best.entry(triangle).or_insert((pixels, label));
        if pixels > most.0 {
            *most = (pixels, label);
        }
    }
    best.into_iter().map(|(triangle, (_, label))| (triangle, label)).collect()
}

/// A colour as HTML writes it, with four digits for each channel where two do not suffice.
fn name(label: Label) -> String {
    let is_short = label.iter().all(|value| value % 257 == 0);
    let digits = |value: u16| if is_short { format!("{:02x}", value / 257) } else { format!("{value:04x}") };
    format!("#{}", label.map(digits).concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::{Camera, Material, SceneBuilder, Shape};
    use glam::{DAffine3, DVec3};

    const RED: Label = [0xffff, 0, 0];
    const NUMBER: Label = [1, 2, 3];

    /// A mesh of two triangles side by side, and one behind the camera.
    fn scene() -> Scene {
        let mut builder = SceneBuilder::new();
        let grey = Material::named("grey");
        builder.shape("floor", Shape::Quad { cells: 1 }, &grey, DAffine3::from_scale(DVec3::splat(4.0)));
        builder.shape("behind", Shape::Quad { cells: 1 }, &grey, DAffine3::from_translation(DVec3::Y * 20.0));
        builder.finish("s").expect("a scene")
    }

    /// A view of the floor, with labels by triangle and pixel.
    fn target(scene: &Scene, label: impl Fn(usize, usize) -> Option<Label>) -> Target {
        let (position, up) = (DVec3::new(2.0, 6.0, 2.0), DVec3::Z);
        let target = DVec3::new(2.0, 0.0, 2.0);
        let camera = Camera { position, target, up, width: 40, height: 40, ..Camera::framing(&[]) };
        let target = Target::new(camera, vec![DVec3::ONE; 1600], None, 1.0).expect("a target");
        let mut labels = vec![None; 1600];
        first_hits(&scene.rays(), &target).for_each(|(at, triangle)| labels[at] = label(triangle, at));
        Target { labels: Some(labels), ..target }
    }

    #[test]
    fn triangles_take_the_label_of_most_pixels() {
        let scene = scene();
        let first = target(&scene, |triangle, at| match triangle {
            0 => Some(if at % 3 == 0 { NUMBER } else { RED }),
            _ => Some(NUMBER),
        });
        let groups = segments(&scene, std::slice::from_ref(&first)).expect("labels").expect("groups");
        let of = |name: &str, triangles: &[u32]| (name.to_owned(), triangles.to_vec());
        let behind = of("behind", &[2, 3]);
        assert_eq!(groups, [of("#000100020003", &[1]), of("#ff0000", &[0]), behind.clone()]);
        // Other views outvote it.
        let other = target(&scene, |_, _| Some(NUMBER));
        let all = segments(&scene, &[first, other]).expect("labels").expect("groups");
        assert_eq!(all, [of("#000100020003", &[0, 1]), behind.clone()]);
        // What is transparent has no label.
        let part = target(&scene, |triangle, _| (triangle == 1).then_some(RED));
        let all = segments(&scene, std::slice::from_ref(&part)).expect("labels").expect("groups");
        assert_eq!(all, [of("#ff0000", &[1]), of("floor", &[0]), behind]);
        assert_eq!(segments(&scene, &[Target { labels: None, ..part }]), Ok(None));
    }

    #[test]
    fn too_many_labels_are_refused() {
        let scene = scene();
        let of = |number: usize| target(&scene, move |_, at| Some([(at % number) as u16, 0, 0]));
        assert!(segments(&scene, &[of(256), of(7)]).is_ok());
        let error = segments(&scene, &[of(257)]).expect_err("too many");
        assert!(error.contains("257 colours") && error.contains("256 labels"), "{error}");
    }
}
