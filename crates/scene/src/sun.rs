//! Light from one direction, from beyond everything.

use std::ops::RangeInclusive;

use glam::DVec3;

use super::Scene;
use super::check::check_light;
use super::sky::NAME as SKY;

/// Degrees. Edges of smaller suns are lost to rounding; a larger one is rather a sky.
const DIAMETERS: RangeInclusive<f64> = 0.01..=90.0;

/// A round light source so far away that all points see it in the same direction. It lights surfaces, and is itself not seen: neither
/// by cameras nor in mirrors, which show its highlights alone.
///
/// A [sky](Scene::add_sky) stands behind it. Everything else blocks it, from both sides.
#[derive(Clone, Debug, PartialEq)]
pub struct Sun {
    /// The direction in which its light travels, of any length: (0, -1, 0) for a sun in the zenith.
    pub direction: DVec3,
    /// Irradiance of a surface that faces it, RGB, W/m².
    pub irradiance: [f64; 3],
    /// The angle at which it is seen from side to side, degrees.
    pub angular_diameter: f64,
}

impl Sun {
    /// The mean angular diameter of the sun as seen from the earth, degrees.
    pub const DIAMETER: f64 = 0.53;

    /// A sun of the size of that of the earth. `direction`: that in which light travels; `irradiance`: of a surface that faces it, W/m².
    pub fn new(direction: DVec3, irradiance: [f64; 3]) -> Self {
        Self { direction, irradiance, angular_diameter: Self::DIAMETER }
    }

    /// The unit direction in which its light travels.
    #[doc(hidden)]
    pub fn travels(&self) -> DVec3 {
        self.direction.normalize_or_zero()
    }

    /// The angle from its middle to its limb, radians.
    #[doc(hidden)]
    pub fn angular_radius(&self) -> f64 {
        (0.5 * self.angular_diameter).to_radians()
    }

    /// Whether its light is grey.
    #[doc(hidden)]
    pub fn is_grey(&self) -> bool {
        let [r, g, b] = self.irradiance;
        r == g && g == b
    }

    /// Checks all values.
    ///
    /// # Errors
    /// Fails if the direction is zero or not finite, if irradiance is negative or not finite, or if the diameter is not from 0.01 to 90
    /// degrees. The error begins with the name of the value.
    pub fn check(&self) -> Result<(), String> {
        self.check_linear()?;
        check_light(self.irradiance).map_err(|wrong| format!("irradiance is {wrong}"))
    }

    /// Checks all values as [`Self::check`] does, but allows negative irradiance.
    pub(super) fn check_linear(&self) -> Result<(), String> {
        let Self { direction, irradiance, angular_diameter } = self;
        if direction.try_normalize().is_none() {
            return Err(format!(
                "direction is ({}, {}, {}); give the direction in which light travels, such as (0, -1, 0)",
                direction.x, direction.y, direction.z
            ));
        }
        if let Some(wrong) = irradiance.iter().find(|h| !h.is_finite()) {
            return Err(format!("irradiance is {wrong}; it must be finite and 0 or more"));
        }
        match DIAMETERS.contains(angular_diameter) {
            true => Ok(()),
            false => Err(format!(
                "angular_diameter is {angular_diameter}; it must lie in {} to {} degrees",
                DIAMETERS.start(),
                DIAMETERS.end()
            )),
        }
    }
}

impl Scene {
    /// Triangles that stand behind all suns, ascending: those of skies, which are known by the names of their meshes.
    #[doc(hidden)]
    pub fn behind_suns(&self) -> Vec<u32> {
        let is_sky = |name: &str| {
            let number = name.strip_prefix(SKY).map(|rest| rest.strip_prefix('_').map(str::parse::<u64>));
            matches!(number, Some(Some(Ok(_)))) || name == SKY
        };
        self.meshes.iter().filter(|mesh| is_sky(&mesh.name)).flat_map(|mesh| mesh.range.clone()).collect()
    }
}
