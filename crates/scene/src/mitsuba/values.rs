//! Values of named children: `<float name="alpha" value="0.1"/>`, with `$name` for `<default name="name" value="…"/>`.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::DVec3;
use roxmltree::Node;

use super::spectrum::{Of, colour};
use crate::error::{Place, SceneError};
use crate::statements::read_text;
use crate::texture::{Encoding, Texture, linear_from_srgb};

pub(super) struct Values<'a> {
    path: &'a Path,
    defaults: HashMap<&'a str, &'a str>,
}

impl<'a> Values<'a> {
    pub fn new<'i>(path: &'a Path, root: Node<'a, 'i>) -> Result<Self, SceneError> {
        let named = root.children().filter(|node| node.has_tag_name("default"));
        let defaults =
            named.filter_map(|node| Some((node.attribute("name")?, node.attribute("value")?))).collect();
        Ok(Self { path, defaults })
    }

    /// An error at the line of a node.
    pub fn wrong(&self, node: Node, message: String) -> SceneError {
        let line = node.document().text_pos_at(node.range().start).row as usize;
        Place { path: self.path, line }.error(message)
    }

    /// A child by its name, in place or referred to.
    fn child<'n, 'i>(&self, node: Node<'n, 'i>, name: &str) -> Option<Node<'n, 'i>> {
        let named = |child: &Node| child.attribute("name") == Some(name);
        let child = node.children().filter(Node::is_element).find(named)?;
        if !child.has_tag_name("ref") {
            return Some(child);
        }
        let id = child.attribute("id")?;
        let mut others = node.document().descendants().filter(|node| !node.has_tag_name("ref"));
        others.find(|other| other.attribute("id") == Some(id))
    }

    /// An attribute, with the defaults put in.
    ///
    /// # Errors
    /// Fails if the attribute uses a name that no `<default>` defines.
    pub fn attribute(&self, node: Node, name: &str) -> Result<Option<String>, SceneError> {
        let Some(text) = node.attribute(name) else { return Ok(None) };
        if !text.contains('$') {
            return Ok(Some(text.to_owned()));
        }
        let mut text = text.to_owned();
        // Longer names first, since one may begin with another.
        let mut defaults: Vec<_> = self.defaults.iter().collect();
        defaults.sort_by_key(|(name, _)| std::cmp::Reverse((name.len(), **name)));
        for (name, value) in defaults {
            text = text.replace(&format!("${name}"), value);
        }
        match text.contains('$') {
            true => Err(self.wrong(node, format!("`{text}` has no <default>"))),
            false => Ok(Some(text)),
        }
    }

    pub fn text(&self, node: Node, name: &str) -> Result<Option<String>, SceneError> {
        match self.child(node, name) {
            Some(child) => self.attribute(child, "value"),
            None => Ok(None),
        }
    }

    pub fn flag(&self, node: Node, name: &str) -> Result<bool, SceneError> {
        Ok(self.text(node, name)?.as_deref() == Some("true"))
    }

    pub fn number(&self, node: Node, name: &str) -> Result<Option<f64>, SceneError> {
        self.text(node, name)?.map(|text| self.parse(node, &text)).transpose()
    }

    fn parse(&self, node: Node, text: &str) -> Result<f64, SceneError> {
        match text.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(self.wrong(node, format!("`{text}` is no finite number"))),
        }
    }

    /// Numbers of an attribute, between blanks or commas.
    ///
    /// # Errors
    /// Fails if a word is no finite number, or uses a name that no `<default>` defines.
    pub fn numbers(&self, node: Node, name: &str) -> Result<Option<Vec<f64>>, SceneError> {
        let Some(text) = self.attribute(node, name)? else { return Ok(None) };
        let words = text.split([',', ' ', '\t', '\n', '\r']).filter(|word| !word.is_empty());
        words.map(|word| self.parse(node, word)).collect::<Result<_, _>>().map(Some)
    }

    /// `x`, `y` and `z`, or three numbers in `value`, of the node itself.
    ///
    /// # Errors
    /// Fails if `value` has neither three numbers nor one, or if a coordinate is no finite number.
    pub fn vector(&self, node: Node, missing: f64) -> Result<DVec3, SceneError> {
        match self.numbers(node, "value")?.as_deref() {
            Some(&[x, y, z]) => return Ok(DVec3::new(x, y, z)),
            Some(&[x]) => return Ok(DVec3::splat(x)),
            Some(other) => {
                return Err(self.wrong(node, format!("has {} numbers; expected three", other.len())));
            }
            None => {}
        }
        let mut vector = DVec3::splat(missing);
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            if let Some(text) = self.attribute(node, name)? {
                vector[axis] = self.parse(node, &text)?;
            }
        }
        Ok(vector)
    }

    pub fn point(&self, node: Node, name: &str) -> Result<Option<DVec3>, SceneError> {
        self.child(node, name).map(|child| self.vector(child, 0.0)).transpose()
    }

    /// A colour: `rgb`, `spectrum` or `float`. A texture gives its mean, or grey, which `ignored` names.
    ///
    /// # Errors
    /// Fails if the element has no value or one that is no colour, or if a file that it names cannot be used.
    pub fn colour(
        &self,
        node: Node,
        name: &str,
        of: Of,
        ignored: &mut Vec<String>,
    ) -> Result<Option<[f64; 3]>, SceneError> {
        let Some(child) = self.child(node, name) else { return Ok(None) };
        if child.has_tag_name("texture") {
            let (colour, what) = match self.mean(child)? {
                Some(mean) => (mean, "textures, their means in their place"),
                None => ([0.5; 3], "textures, grey 0.5 in their place"),
            };
            if !ignored.iter().any(|known| known == what) {
                ignored.push(what.to_owned());
            }
            return Ok(Some(colour));
        }
        let spectrum = child.has_tag_name("spectrum");
        if let (true, Some(file)) = (spectrum, self.attribute(child, "filename")?) {
            return Ok(Some(colour(&self.measured(child, &file)?, of)));
        }
        let Some(text) = self.attribute(child, "value")? else {
            return Err(self.wrong(child, "has no value".to_owned()));
        };
        if let Some(hex) = text.trim().strip_prefix('#') {
            let Some(bits) = u32::from_str_radix(hex, 16).ok().filter(|_| hex.len() == 6) else {
                return Err(self.wrong(child, format!("`{text}` is no colour")));
            };
            return Ok(Some(
                [16, 8, 0].map(|shift| linear_from_srgb(f64::from(bits >> shift & 255) / 255.0)),
            ));
        }
        if spectrum && text.contains(':') {
            let pairs = text.split([',', ' ', '\t', '\n', '\r']).filter(|pair| !pair.is_empty());
            let samples = pairs.map(|pair| match pair.split_once(':') {
                Some((wavelength, value)) => Ok((self.parse(child, wavelength)?, self.parse(child, value)?)),
                None => Err(self.wrong(child, format!("`{pair}` is no `wavelength:value`"))),
            });
            return Ok(Some(colour(&self.ascending(child, samples.collect::<Result<_, _>>()?)?, of)));
        }
        match self.numbers(child, "value")?.as_deref() {
            // The same at all wavelengths; a lamp like that is not white.
            Some(&[value]) if spectrum => {
                Ok(Some(colour(&[(0.0, 1.0), (1e4, 1.0)], of).map(|channel| value * channel)))
            }
            Some(&[grey]) => Ok(Some([grey; 3])),
            Some(&[r, g, b]) => Ok(Some([r, g, b])),
            _ => Err(self.wrong(child, format!("`{text}` is no colour; expected `r, g, b`"))),
        }
    }

    /// The spectrum in a file: lines of a wavelength and a value.
    fn measured(&self, node: Node, name: &str) -> Result<Vec<(f64, f64)>, SceneError> {
        let file = self.beside(name);
        let text = read_text(&file)
            .map_err(|reason| self.wrong(node, format!("{} cannot be read: {reason}", file.display())))?;
        let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default().trim());
        let samples = lines.filter(|line| !line.is_empty()).map(|line| {
            let words: Vec<&str> = line.split_whitespace().collect();
            match words[..] {
                [wavelength, value] => Ok((self.parse(node, wavelength)?, self.parse(node, value)?)),
                _ => {
                    Err(self.wrong(node, format!("{}: `{line}` is no wavelength and value", file.display())))
                }
            }
        });
        self.ascending(node, samples.collect::<Result<_, _>>()?)
    }

    fn ascending(&self, node: Node, samples: Vec<(f64, f64)>) -> Result<Vec<(f64, f64)>, SceneError> {
        match samples.windows(2).find(|pair| pair[0].0 >= pair[1].0) {
            Some(pair) => {
                Err(self
                    .wrong(node, format!("wavelength {} follows {}; they must ascend", pair[1].0, pair[0].0)))
            }
            None => Ok(samples),
        }
    }

    /// The mean of a picture that is a texture; `None` for other textures.
    fn mean(&self, texture: Node) -> Result<Option<[f64; 3]>, SceneError> {
        let Some(name) = self.text(texture, "filename")? else { return Ok(None) };
        let file = self.beside(&name);
        let encoding = if self.flag(texture, "raw")? { Encoding::Linear } else { Encoding::Srgb };
        let read = Texture::read(&file, encoding);
        let read = read.map_err(|message| self.wrong(texture, format!("{} {message}", file.display())))?;
        Ok(read.map(|texture| texture.mean().into()))
    }

    /// A file that the scene names.
    pub fn beside(&self, name: &str) -> PathBuf {
        self.path.parent().unwrap_or(Path::new("")).join(name)
    }
}
