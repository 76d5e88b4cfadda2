//! Emitters that are no shapes: skies, suns, and lights from points.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DMat3, DMat4, DVec3};

use super::Reader;
use super::element::Element;
use super::spectrum::Of;
use crate::error::SceneError;
use crate::point_lights::PointLight;
use crate::{Sky, Sun};

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
                let turn = rotation(self.place(node)?).unwrap_or_else(|| {
                    self.ignore("the to_world of <emitter type=\"envmap\">, which is no rotation".to_owned());
                    DMat3::IDENTITY
                });
                // The middle of the picture is +z, and +x is to the left of it.
                let turn = turn * DMat3::from_diagonal(DVec3::new(-1.0, 1.0, -1.0));
                let scale = self.values.number(node, "scale")?.unwrap_or(1.0);
                let file = self.values.beside(name);
                Sky::read_turned(&file, [scale; 3], turn)
                    .map_err(|message| node.wrong(format!("{} {message}", file.display())))?
            }
            "point" | "spot" => return self.light(node),
            "directional" => return self.directional(node),
            "sun" | "sunsky" => {
                self.ignore(format!(
                    "<emitter type=\"{kind}\">, for which [sun] and [sky] of a scene file may stand"
                ));
                return Ok(());
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

    /// Parallel light.
    fn directional(&mut self, node: &'a Element) -> Result<(), SceneError> {
        let irradiance = self.values.colour(node, "irradiance", Of::Emission, &mut self.ignored)?;
        let along = self.place(node)?.transform_vector3(DVec3::Z);
        let direction = self.values.point(node, "direction")?.unwrap_or(along);
        let sun = Sun::new(direction, irradiance.unwrap_or([1.0; 3]));
        sun.check().map_err(|message| node.wrong(message))?;
        self.contents.suns.push(sun);
        Ok(())
    }

    /// Light from a point, all around or within a cone about +z.
    fn light(&mut self, node: &'a Element) -> Result<(), SceneError> {
        let place = self.place(node)?;
        let intensity = self.values.colour(node, "intensity", Of::Emission, &mut self.ignored)?;
        let intensity = DVec3::from(intensity.unwrap_or([1.0; 3]));
        let origin = place.transform_point3(DVec3::ZERO);
        let (position, axis, solid_angle) = if node.kind() == "point" {
            (self.values.point(node, "position")?.unwrap_or(origin), None, 2.0 * TAU)
        } else {
            let [outer, inner] =
                [self.values.number(node, "cutoff_angle")?, self.values.number(node, "beam_width")?];
            let outer = outer.unwrap_or(20.0).to_radians().clamp(0.0, FRAC_PI_2);
            let inner = inner.map_or(0.75 * outer, f64::to_radians).clamp(0.0, outer);
            // Within the beam the intensity is constant; from there it falls in proportion to the angle.
            let mean_sine =
                if outer > inner { (outer.sin() - inner.sin()) / (outer - inner) } else { inner.cos() };
            (origin, Some(place.transform_vector3(DVec3::Z).normalize_or(DVec3::Z)), TAU * (1.0 - mean_sine))
        };
        let name = self.free_name(node.attribute("id").unwrap_or(node.kind()));
        self.lights.push(PointLight { name, position, axis, power: intensity * solid_angle });
        Ok(())
    }
}

/// The directions of a transform that turns or mirrors, and scales alike in all directions.
fn rotation(place: DMat4) -> Option<DMat3> {
    let matrix = DMat3::from_mat4(place);
    let turn = matrix * (1.0 / matrix.x_axis.length());
    (turn.transpose() * turn).abs_diff_eq(DMat3::IDENTITY, 1e-6).then_some(turn)
}
