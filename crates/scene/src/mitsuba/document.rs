//! Files as one tree of elements: `<include>` is replaced by what the file holds, `$name` by what `<default>` says, and names of
//! version 0 and 1 by those of version 3.

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use roxmltree::{Document, Node};

use super::element::{Element, File};
use crate::error::{Place, SceneError};

/// Most bytes of a file.
const MOST_BYTES: u64 = 1 << 28;
/// Most elements of all files, each counted as often as it is included.
const MOST_ELEMENTS: usize = 1 << 22;
/// Files in one another, and elements in one another.
const MOST_FILES: usize = 16;
const MOST_LEVELS: usize = 256;

/// The elements of a scene, and the folders in which it names files, the first first.
pub(super) struct Source {
    pub root: Element,
    pub folders: Vec<PathBuf>,
}

impl Source {
    /// Reads a file and those that it includes.
    ///
    /// # Errors
    /// Fails if a file cannot be read, is no XML or no scene, or includes itself.
    pub fn read(path: &Path) -> Result<Self, SceneError> {
        let open = path.canonicalize().into_iter().collect();
        let mut loader = Loader { defaults: Vec::new(), folders: Vec::new(), open, levels: 0, elements: 0 };
        let root = loader.file(path)?;
        Ok(Self { root, folders: loader.folders })
    }
}

/// A file that is named: in the first of the folders that has it.
pub(super) fn named(folders: &[PathBuf], name: &str) -> PathBuf {
    let name = name.replace('\\', "/");
    let places = folders.iter().map(|folder| folder.join(&name));
    places.clone().find(|place| place.exists()).or(places.clone().next()).unwrap_or(name.into())
}

struct Loader {
    /// Names after their `$`, and values.
    defaults: Vec<(String, String)>,
    folders: Vec<PathBuf>,
    /// The files that include one another.
    open: Vec<PathBuf>,
    levels: usize,
    elements: usize,
}

impl Loader {
    fn file(&mut self, path: &Path) -> Result<Element, SceneError> {
        let bytes = antirad_base::input::read_at_most(path, MOST_BYTES)
            .map_err(|reason| SceneError::Read { path: path.to_path_buf(), reason })?;
        let text = String::from_utf8(bytes).map_err(|_| SceneError::File {
            path: path.to_path_buf(),
            message: String::from("is not in UTF-8"),
        })?;
        let file = Rc::new(File { path: path.to_path_buf(), text });
        let document = Document::parse(&file.text).map_err(|error| {
            let line = error.pos().row as usize;
            Place { path, line }.error(format!("is no XML: {error}"))
        })?;
        let root = document.root_element();
        let folder = path.parent().unwrap_or(Path::new("")).to_path_buf();
        if !self.folders.contains(&folder) {
            self.folders.push(folder);
        }
        for node in root.children().filter(|node| node.has_tag_name("default")) {
            if let (Some(name), Some(value)) = (node.attribute("name"), node.attribute("value")) {
                let value = self.substituted(value);
                // Longer names first, since one may begin with another. What includes this file goes before.
                if !self.defaults.iter().any(|(known, _)| known == name) {
                    let at = self.defaults.partition_point(|(known, _)| known.len() >= name.len());
                    self.defaults.insert(at, (name.to_owned(), value));
                }
            }
        }
        let version =
            root.attribute("version").and_then(|version| version.split('.').next()?.trim().parse().ok());
        let old = version.is_some_and(|major: u32| major < 2);
        let root = self.element(root, old, &file)?;
        if !root.is("scene") {
            return Err(root.wrong(format!("expected <scene>, not <{}>", root.tag)));
        }
        Ok(root)
    }

    fn element(&mut self, node: Node, old: bool, file: &Rc<File>) -> Result<Element, SceneError> {
        let attributes = node.attributes().map(|attribute| {
            let value = self.substituted(attribute.value());
            let value = if old && attribute.name() == "name" { snake_case(&value) } else { value };
            (attribute.name().to_owned(), value)
        });
        let mut element = Element {
            tag: match node.tag_name().name() {
                "lookAt" if old => "lookat".to_owned(),
                tag => tag.to_owned(),
            },
            attributes: attributes.collect(),
            children: Vec::new(),
            file: file.clone(),
            start: node.range().start,
            asked: Cell::new(false),
            found: Cell::new(false),
        };
        self.elements += 1;
        if self.elements > MOST_ELEMENTS || self.levels == MOST_LEVELS {
            return Err(element.wrong(format!(
                "there are more than {MOST_ELEMENTS} elements with all that is included, or {MOST_LEVELS} in one another"
            )));
        }
        self.levels += 1;
        for child in node.children().filter(Node::is_element) {
            let mut child = self.element(child, old, file)?;
            match child.tag.as_str() {
                "include" => element.children.extend(self.include(&child)?.children),
                "path" => {
                    let folder = child.attribute("value").map(|folder| named(&self.folders, folder));
                    self.folders.extend(folder);
                }
                _ => {
                    if old && element.attribute("type") == Some("diffuse") {
                        for (_, name) in child.attributes.iter_mut().filter(|(key, _)| key == "name") {
                            if name == "diffuse_reflectance" {
                                *name = "reflectance".to_owned();
                            }
                        }
                    }
                    element.children.push(child);
                }
            }
        }
        self.levels -= 1;
        Ok(element)
    }

    fn include(&mut self, element: &Element) -> Result<Element, SceneError> {
        let name = element.attribute("filename").ok_or_else(|| element.wrong("has no filename"))?;
        let path = named(&self.folders, name);
        let same = path.canonicalize().unwrap_or_else(|_| path.clone());
        if self.open.contains(&same) || self.open.len() == MOST_FILES {
            return Err(element
                .wrong(format!("{name} is included by itself, or by {MOST_FILES} files in one another")));
        }
        self.open.push(same);
        let read = self.file(&path);
        self.open.pop();
        read.map_err(|error| match error {
            SceneError::Read { path, reason } => {
                element.wrong(format!("{} cannot be read: {reason}", path.display()))
            }
            other => other,
        })
    }

    fn substituted(&self, text: &str) -> String {
        let mut text = text.to_owned();
        if text.contains('$') {
            for (name, value) in &self.defaults {
                text = text.replace(&format!("${name}"), value);
            }
        }
        text
    }
}

/// `toWorld` as `to_world` and `intIOR` as `int_ior`: a `_` stands where capitals follow a small letter.
fn snake_case(name: &str) -> String {
    let mut snake = String::new();
    let mut capitals = false;
    let mut before = ' ';
    for letter in name.chars() {
        let starts = before.is_ascii_lowercase() && letter.is_ascii_uppercase();
        capitals = starts || (capitals && letter.is_ascii_uppercase());
        if starts {
            snake.push('_');
        }
        snake.push(if capitals { letter.to_ascii_lowercase() } else { letter });
        before = letter;
    }
    snake
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_names_become_new_ones() {
        for (old, new) in [
            ("toWorld", "to_world"),
            ("intIOR", "int_ior"),
            ("flipTexCoords", "flip_tex_coords"),
            ("fovAxis", "fov_axis"),
            ("radiance", "radiance"),
            ("to_world", "to_world"),
            ("uscale", "uscale"),
            ("", ""),
        ] {
            assert_eq!(snake_case(old), new);
        }
    }
}
