//! Values of named children: `<float name="alpha" value="0.1"/>`, with `$name` for `<default name="name" value="…"/>`.

use std::collections::HashMap;
use std::path::Path;

use glam::DVec3;
use roxmltree::Node;

use crate::scene::error::{Place, SceneError};
use crate::scene::texture::linear_from_srgb;

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

    fn child<'n, 'i>(&self, node: Node<'n, 'i>, name: &str) -> Option<Node<'n, 'i>> {
        node.children().filter(Node::is_element).find(|child| child.attribute("name") == Some(name))
    }

    /// An attribute, with the defaults put in.
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
    pub fn numbers(&self, node: Node, name: &str) -> Result<Option<Vec<f64>>, SceneError> {
        let Some(text) = self.attribute(node, name)? else { return Ok(None) };
        let words = text.split([',', ' ', '\t', '\n', '\r']).filter(|word| !word.is_empty());
        words.map(|word| self.parse(node, word)).collect::<Result<_, _>>().map(Some)
    }

    /// `x`, `y` and `z`, or three numbers in `value`, of the node itself.
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

    /// A colour: `rgb`, `spectrum` or `float`. A spectrum over wavelengths gives its mean, a texture grey, both named in `ignored`.
    pub fn colour(
        &self,
        node: Node,
        name: &str,
        ignored: &mut Vec<String>,
    ) -> Result<Option<[f64; 3]>, SceneError> {
        let Some(child) = self.child(node, name) else { return Ok(None) };
        let mut ignore = |what: &str| {
            if !ignored.iter().any(|known| known == what) {
                ignored.push(what.to_owned());
            }
        };
        if child.has_tag_name("texture") {
            ignore("textures, grey 0.5 in their place");
            return Ok(Some([0.5; 3]));
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
        if text.contains(':') {
            ignore("spectra, their means in their place");
            let values = text.split(',').filter_map(|pair| pair.split(':').nth(1));
            let values: Vec<f64> = values.map(|value| self.parse(child, value)).collect::<Result<_, _>>()?;
            return Ok(Some([values.iter().sum::<f64>() / values.len().max(1) as f64; 3]));
        }
        match self.numbers(child, "value")?.as_deref() {
            Some(&[grey]) => Ok(Some([grey; 3])),
            Some(&[r, g, b]) => Ok(Some([r, g, b])),
            _ => Err(self.wrong(child, format!("`{text}` is no colour; expected `r, g, b`"))),
        }
    }
}
