//! The elements of a scene, which remember what was asked of them: so that nothing is passed over in silence.

use std::cell::Cell;
use std::path::PathBuf;
use std::rc::Rc;

use crate::error::{Place, SceneError};

/// A file, and its text.
pub(super) struct File {
    pub path: PathBuf,
    pub text: String,
}

/// An element, with its includes, defaults and old names resolved.
pub(super) struct Element {
    pub tag: String,
    pub attributes: Vec<(String, String)>,
    pub children: Vec<Element>,
    pub file: Rc<File>,
    /// Where it begins in the text, in bytes.
    pub start: usize,
    /// Whether children were looked for by their names.
    pub asked: Cell<bool>,
    /// Whether it was found that way.
    pub found: Cell<bool>,
}

/// What makes no difference here: of films, of how pictures are sampled, and of how lobes and normals are.
const HARMLESS: [&str; 20] = [
    "aperture_radius",
    "banner",
    "component_format",
    "face_normals",
    "far_clip",
    "file_format",
    "filter_type",
    "focus_distance",
    "high_quality_edges",
    "max_smooth_angle",
    "near_clip",
    "nonlinear",
    "pixel_format",
    "sample_border",
    "sampling_weight",
    "shutter_close",
    "shutter_open",
    "rfilter",
    "sampler",
    "integrator",
];

impl Element {
    pub fn is(&self, tag: &str) -> bool {
        self.tag == tag
    }

    pub fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// The type of an object.
    pub fn kind(&self) -> &str {
        self.attribute("type").unwrap_or_default()
    }

    /// The element and all in it.
    pub fn all(&self) -> Vec<&Self> {
        let mut all = vec![self];
        let mut next = 0;
        while let Some(&element) = all.get(next) {
            all.extend(&element.children);
            next += 1;
        }
        all
    }

    /// Takes its children as found: something stands for it as a whole.
    pub fn pass_over(&self) {
        self.children.iter().for_each(|child| child.found.set(true));
    }

    /// An error at its line.
    pub fn wrong(&self, message: impl Into<String>) -> SceneError {
        let before = self.file.text.as_bytes().iter().take(self.start);
        let line = before.filter(|&&byte| byte == b'\n').count() + 1;
        Place { path: &self.file.path, line }.error(message)
    }

    /// The children that were not found of those elements whose children were looked for.
    pub fn unread(&self) -> Vec<String> {
        let mut unread = Vec::new();
        for parent in self.all().into_iter().filter(|element| element.asked.get()) {
            for child in parent.children.iter().filter(|child| !child.found.get()) {
                let harmless = |name: &str| HARMLESS.contains(&name);
                if child.attribute("name").is_some_and(harmless) || harmless(&child.tag) {
                    continue;
                }
                let shown = ["type", "name", "id"]
                    .into_iter()
                    .filter_map(|name| Some((name, child.attribute(name)?)));
                let attributes: String = shown.map(|(name, value)| format!(" {name}=\"{value}\"")).collect();
                unread.push(format!(
                    "<{}{attributes}> of <{} type=\"{}\">",
                    child.tag,
                    parent.tag,
                    parent.kind()
                ));
            }
        }
        unread
    }
}
