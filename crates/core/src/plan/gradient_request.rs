//! Which derivatives are requested: others are neither planned nor computed.

use antirad_base::setters;

/// Kinds of derivatives of a loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct GradientRequest {
    /// Derivatives with respect to the emitted radiance L_e.
    pub emission: bool,
    /// Derivatives with respect to the diffuse constant δ.
    pub diffuse: bool,
    /// Derivatives with respect to the albedo ρ.
    pub albedo: bool,
    /// Derivatives with respect to the specular constant σ, of glossy triangles.
    pub specular: bool,
    /// Derivatives with respect to the power p, of glossy triangles.
    pub power: bool,
    /// Derivatives with respect to the positions of vertices.
    pub positions: bool,
    /// Derivatives with respect to the positions of the cameras.
    pub camera: bool,
}

setters!(GradientRequest {
    emission: bool,
    diffuse: bool,
    albedo: bool,
    specular: bool,
    power: bool,
    positions: bool,
    camera: bool,
});

impl GradientRequest {
    /// No derivatives.
    pub const NOTHING: Self = Self {
        emission: false,
        diffuse: false,
        albedo: false,
        specular: false,
        power: false,
        positions: false,
        camera: false,
    };
    /// All kinds of derivatives.
    pub const EVERYTHING: Self = Self {
        emission: true,
        diffuse: true,
        albedo: true,
        specular: true,
        power: true,
        positions: true,
        camera: true,
    };

    /// Whether any kind is requested.
    #[doc(hidden)]
    pub fn any(self) -> bool {
        self != Self::NOTHING
    }

    /// Whether a kind is requested that differentiates the geometry.
    #[doc(hidden)]
    pub fn geometry(self) -> bool {
        self.positions || self.camera
    }

    /// Whether a kind is requested that changes the light of triangles, as cameras do not.
    #[doc(hidden)]
    pub fn light(self) -> bool {
        self.camera(false).any()
    }

    /// Whether a kind of specular lobes is requested.
    #[doc(hidden)]
    pub fn lobes(self) -> bool {
        self.specular || self.power
    }

    /// The names of the kinds requested here but not in `planned`.
    #[doc(hidden)]
    pub fn beyond(self, planned: Self) -> Vec<&'static str> {
        let kinds = [
            ("emission", self.emission, planned.emission),
            ("diffuse", self.diffuse, planned.diffuse),
            ("albedo", self.albedo, planned.albedo),
            ("specular", self.specular, planned.specular),
            ("power", self.power, planned.power),
            ("positions", self.positions, planned.positions),
            ("camera", self.camera, planned.camera),
        ];
        kinds
            .into_iter()
            .filter(|&(_, request, planned)| request && !planned)
            .map(|(name, ..)| name)
            .collect()
    }
}
