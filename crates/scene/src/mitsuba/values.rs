//! Values of named children: `<float name="alpha" value="0.1"/>`.

use std::cell::RefCell;
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use glam::{DAffine2, DMat4, DVec2, DVec3};

use super::document::{Source, named};
use super::element::Element;
use super::spectrum::{Of, colour};
use super::transform;
use crate::error::SceneError;
use crate::statements::read_text;
use crate::texture::{Encoding, Map, Texture, Wrap, linear_from_srgb};

/// Pictures by their files; `None` for those that are neither PNG nor JPEG.
type Pictures = HashMap<(PathBuf, Encoding), Option<Arc<Texture>>>;

/// What the children of elements say.
pub(super) struct Values<'a> {
    by_id: HashMap<&'a str, &'a Element>,
    folders: &'a [PathBuf],
    textures: RefCell<Pictures>,
}

/// A colour, and a texture that it multiplies.
#[derive(Clone, Default)]
pub(super) struct Coloured {
    pub factor: [f64; 3],
    pub map: Option<Map>,
}

impl<'a> Values<'a> {
    pub fn new(source: &'a Source) -> Self {
        let mut by_id = HashMap::new();
        for element in source.root.all() {
            let Some(id) = element.attribute("id") else { continue };
            match element.tag.as_str() {
                "ref" => {}
                "alias" => {
                    let known = by_id.get(id).copied();
                    by_id.extend(element.attribute("as").zip(known));
                }
                _ => {
                    by_id.insert(id, element);
                }
            }
        }
        Self { by_id, folders: &source.folders, textures: RefCell::default() }
    }

    /// What a `<ref>` refers to; other elements are themselves.
    pub fn resolved(&self, element: &'a Element) -> Option<&'a Element> {
        match element.is("ref") {
            true => self.by_id.get(element.attribute("id")?).copied(),
            false => Some(element),
        }
    }

    /// The first child, in place or referred to, for which something holds.
    fn first(
        &self,
        node: &'a Element,
        given: impl Fn(&Element) -> bool,
        resolved: impl Fn(&Element) -> bool,
    ) -> Option<&'a Element> {
        node.asked.set(true);
        node.children.iter().filter(|child| given(child)).find_map(|child| {
            let found = self.resolved(child).filter(|found| resolved(found))?;
            child.found.set(true);
            Some(found)
        })
    }

    /// A child by its name.
    fn child(&self, node: &'a Element, name: &str) -> Option<&'a Element> {
        self.first(node, |child| child.attribute("name") == Some(name), |_| true)
    }

    /// A child of a kind.
    pub fn object(&self, node: &'a Element, tag: &str) -> Option<&'a Element> {
        self.first(node, |_| true, |child| child.is(tag))
    }

    /// A transform by its name.
    ///
    /// # Errors
    /// Fails if it is malformed, or not affine.
    pub fn transform(&self, node: &'a Element, name: &str) -> Result<Option<DMat4>, SceneError> {
        self.child(node, name).map(|child| transform::read(child, self)).transpose()
    }

    /// An attribute.
    ///
    /// # Errors
    /// Fails if the attribute uses a name that no `<default>` defines.
    pub fn attribute(&self, node: &'a Element, name: &str) -> Result<Option<&'a str>, SceneError> {
        match node.attribute(name) {
            Some(text) if text.contains('$') => Err(node.wrong(format!("`{text}` has no <default>"))),
            text => Ok(text),
        }
    }

    pub fn text(&self, node: &'a Element, name: &str) -> Result<Option<&'a str>, SceneError> {
        match self.child(node, name) {
            Some(child) => self.attribute(child, "value"),
            None => Ok(None),
        }
    }

    pub fn flag(&self, node: &'a Element, name: &str) -> Result<bool, SceneError> {
        Ok(self.text(node, name)? == Some("true"))
    }

    pub fn number(&self, node: &'a Element, name: &str) -> Result<Option<f64>, SceneError> {
        self.text(node, name)?.map(|text| self.parse(node, text)).transpose()
    }

    fn parse(&self, node: &'a Element, text: &str) -> Result<f64, SceneError> {
        match text.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(node.wrong(format!("`{text}` is no finite number"))),
        }
    }

    /// Numbers of an attribute, between blanks or commas.
    ///
    /// # Errors
    /// Fails if a word is no finite number, or uses a name that no `<default>` defines.
    pub fn numbers(&self, node: &'a Element, name: &str) -> Result<Option<Vec<f64>>, SceneError> {
        let Some(text) = self.attribute(node, name)? else { return Ok(None) };
        let words = text.split([',', ' ', '\t', '\n', '\r']).filter(|word| !word.is_empty());
        words.map(|word| self.parse(node, word)).collect::<Result<_, _>>().map(Some)
    }

    /// `x`, `y` and `z`, or three numbers in `value`, of the node itself.
    ///
    /// # Errors
    /// Fails if `value` has neither three numbers nor one, or if a coordinate is no finite number.
    pub fn vector(&self, node: &'a Element, missing: f64) -> Result<DVec3, SceneError> {
        match self.numbers(node, "value")?.as_deref() {
            Some(&[x, y, z]) => return Ok(DVec3::new(x, y, z)),
            Some(&[x]) => return Ok(DVec3::splat(x)),
            Some(other) => {
                return Err(node.wrong(format!("has {} numbers; expected three", other.len())));
            }
            None => {}
        }
        let mut vector = DVec3::splat(missing);
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            if let Some(text) = self.attribute(node, name)? {
                vector[axis] = self.parse(node, text)?;
            }
        }
        Ok(vector)
    }

    pub fn point(&self, node: &'a Element, name: &str) -> Result<Option<DVec3>, SceneError> {
        self.child(node, name).map(|child| self.vector(child, 0.0)).transpose()
    }

    /// A colour: `rgb`, `srgb`, `spectrum` or `float`. A texture gives its mean, or grey, which `ignored` names.
    ///
    /// # Errors
    /// Fails if the element has no value or one that is no colour, or if a file that it names cannot be used.
    pub fn colour(
        &self,
        node: &'a Element,
        name: &str,
        of: Of,
        ignored: &mut Vec<String>,
    ) -> Result<Option<[f64; 3]>, SceneError> {
        let Some(Coloured { factor, map }) = self.coloured(node, name, of, ignored)? else { return Ok(None) };
        let Some(map) = map else { return Ok(Some(factor)) };
        note(ignored, format!("textures of {name}, their means in their place"));
        Ok(Some((DVec3::from(factor) * map.texture.mean()).into()))
    }

    /// A colour as [`Self::colour`] reads it, in which bitmaps of PNG and JPEG files stay textures.
    ///
    /// # Errors
    /// Fails as [`Self::colour`] does.
    pub fn coloured(
        &self,
        node: &'a Element,
        name: &str,
        of: Of,
        ignored: &mut Vec<String>,
    ) -> Result<Option<Coloured>, SceneError> {
        let Some(child) = self.child(node, name) else { return Ok(None) };
        if child.is("texture") {
            let map = self.map(child, ignored)?;
            let factor = if map.is_some() { [1.0; 3] } else { [0.5; 3] };
            if map.is_none() {
                child.pass_over();
                note(ignored, format!("<texture type=\"{}\">, grey 0.5 in its place", child.kind()));
            }
            return Ok(Some(Coloured { factor, map }));
        }
        Ok(Some(Coloured { factor: self.flat(child, of)?, map: None }))
    }

    /// The colour that an element states.
    fn flat(&self, child: &'a Element, of: Of) -> Result<[f64; 3], SceneError> {
        let spectrum = child.is("spectrum");
        if let (true, Some(file)) = (spectrum, self.attribute(child, "filename")?) {
            return Ok(colour(&self.measured(child, file)?, of));
        }
        let Some(text) = self.attribute(child, "value")? else {
            return Err(child.wrong("has no value"));
        };
        if let Some(hex) = text.trim().strip_prefix('#') {
            let Some(bits) = u32::from_str_radix(hex, 16).ok().filter(|_| hex.len() == 6) else {
                return Err(child.wrong(format!("`{text}` is no colour")));
            };
            return Ok([16, 8, 0].map(|shift| linear_from_srgb(f64::from(bits >> shift & 255) / 255.0)));
        }
        if spectrum && text.contains(':') {
            let pairs = text.split([',', ' ', '\t', '\n', '\r']).filter(|pair| !pair.is_empty());
            let samples = pairs.map(|pair| match pair.split_once(':') {
                Some((wavelength, value)) => Ok((self.parse(child, wavelength)?, self.parse(child, value)?)),
                None => Err(child.wrong(format!("`{pair}` is no `wavelength:value`"))),
            });
            return Ok(colour(&ascending(child, samples.collect::<Result<_, _>>()?)?, of));
        }
        let rgb = match self.numbers(child, "value")?.as_deref() {
            // The same at all wavelengths; a lamp like that is not white.
            Some(&[value]) if spectrum => {
                colour(&[(0.0, 1.0), (1e4, 1.0)], of).map(|channel| value * channel)
            }
            Some(&[grey]) => [grey; 3],
            Some(&[r, g, b]) => [r, g, b],
            _ => return Err(child.wrong(format!("`{text}` is no colour; expected `r, g, b`"))),
        };
        Ok(if child.is("srgb") { rgb.map(linear_from_srgb) } else { rgb })
    }

    /// The spectrum in a file: lines of a wavelength and a value.
    fn measured(&self, node: &'a Element, name: &str) -> Result<Vec<(f64, f64)>, SceneError> {
        let file = self.beside(name);
        let text = read_text(&file)
            .map_err(|reason| node.wrong(format!("{} cannot be read: {reason}", file.display())))?;
        let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default().trim());
        let samples = lines.filter(|line| !line.is_empty()).map(|line| {
            let words: Vec<&str> = line.split_whitespace().collect();
            match words[..] {
                [wavelength, value] => Ok((self.parse(node, wavelength)?, self.parse(node, value)?)),
                _ => Err(node.wrong(format!("{}: `{line}` is no wavelength and value", file.display()))),
            }
        });
        ascending(node, samples.collect::<Result<_, _>>()?)
    }

    /// The picture of a bitmap; `None` for other textures, and for pictures that are neither PNG nor JPEG.
    fn map(&self, texture: &'a Element, ignored: &mut Vec<String>) -> Result<Option<Map>, SceneError> {
        if texture.kind() != "bitmap" {
            return Ok(None);
        }
        let Some(name) = self.text(texture, "filename")? else {
            return Err(texture.wrong("has no <string name=\"filename\">"));
        };
        let wrap = match self.text(texture, "wrap_mode")? {
            None | Some("repeat") => Wrap::Repeat,
            Some("clamp") => Wrap::Clamp,
            Some("mirror") => Wrap::Mirror,
            Some(other) => {
                note(ignored, format!("the wrap_mode \"{other}\" of textures, which repeat"));
                Wrap::Repeat
            }
        };
        let encoding = if self.flag(texture, "raw")? { Encoding::Linear } else { Encoding::Srgb };
        let key = (self.beside(name), encoding);
        let known = self.textures.borrow().get(&key).cloned();
        let picture = match known {
            Some(picture) => picture,
            None => {
                let read = Texture::read(&key.0, encoding);
                let read = read.map_err(|message| texture.wrong(format!("{} {message}", key.0.display())))?;
                let read = read.map(Arc::new);
                self.textures.borrow_mut().insert(key, read.clone());
                read
            }
        };
        let place = match self.transform(texture, "to_uv")? {
            Some(DMat4 { x_axis, y_axis, w_axis, .. }) => DAffine2::from_cols(
                x_axis.truncate().truncate(),
                y_axis.truncate().truncate(),
                w_axis.truncate().truncate(),
            ),
            // As files of version 0 have it.
            None => {
                let pair = |u, v, usual: f64| -> Result<DVec2, SceneError> {
                    let [u, v] = [self.number(texture, u)?, self.number(texture, v)?];
                    Ok(DVec2::new(u.unwrap_or(usual), v.unwrap_or(usual)))
                };
                let (scale, offset) = (pair("uscale", "vscale", 1.0)?, pair("uoffset", "voffset", 0.0)?);
                DAffine2::from_scale(scale) * DAffine2::from_translation(offset)
            }
        };
        Ok(picture.map(|texture| Map { texture, place, wrap: [wrap; 2] }))
    }

    /// A file that the scene names.
    pub fn beside(&self, name: &str) -> PathBuf {
        named(self.folders, name)
    }
}

fn ascending(node: &Element, samples: Vec<(f64, f64)>) -> Result<Vec<(f64, f64)>, SceneError> {
    match samples.windows(2).find(|pair| pair[0].0 >= pair[1].0) {
        Some(pair) => {
            Err(node.wrong(format!("wavelength {} follows {}; they must ascend", pair[1].0, pair[0].0)))
        }
        None => Ok(samples),
    }
}

/// Adds what is left out or represented otherwise to a list, once.
pub(super) fn note(ignored: &mut Vec<String>, what: String) {
    if !ignored.contains(&what) {
        ignored.push(what);
    }
}
