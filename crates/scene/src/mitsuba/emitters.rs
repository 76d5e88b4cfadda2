//! Emitters that are no shapes: skies.

use glam::DMat4;

use super::Reader;
use super::element::Element;
use super::spectrum::Of;
use crate::Sky;
use crate::error::SceneError;

impl<'a> Reader<'a> {
    /// An emitter that is no shape.
    pub(super) fn emitter(&mut self, node: &'a Element) -> Result<(), SceneError> {
        let kind = node.kind();
        let sky = match kind {
            "constant" => {
                let radiance = self.values.colour(node, "radiance", Of::Emission, &mut self.ignored)?;
                let sky = Sky::uniform(radiance.unwrap_or([1.0; 3]));
                sky.check().map(|()| sky).map_err(|message| node.wrong(message))?
            }
            "envmap" => {
                let Some(name) = self.values.text(node, "filename")? else {
                    return Err(node.wrong("has no <string name=\"filename\">"));
                };
                if self.place(node)? != DMat4::IDENTITY {
                    self.ignore("the to_world of <emitter type=\"envmap\">".to_owned());
                }
                let scale = self.values.number(node, "scale")?.unwrap_or(1.0);
                let file = self.values.beside(name);
                Sky::read(&file, [scale; 3])
                    .map_err(|message| node.wrong(format!("{} {message}", file.display())))?
            }
            _ => {
                self.ignore(format!("<emitter type=\"{kind}\">"));
                return Ok(());
            }
        };
        if self.contents.sky.replace(sky).is_some() {
            self.ignore("all emitters from afar but the last".to_owned());
        }
        Ok(())
    }
}
