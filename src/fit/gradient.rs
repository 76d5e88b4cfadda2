//! Derivatives of a loss by what a scene is made of.

use crate::plan::GradientRequest;
use crate::scene::Scene;
use glam::DVec3;

/// What can be fitted, and what derivatives can be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Emitted radiance L_e, RGB, W/(m² sr).
    Emission,
    /// Diffuse constant δ.
    Diffuse,
    /// Albedo ρ, RGB.
    Albedo,
    /// Specular constant σ, RGB.
    Specular,
    /// Blinn-Phong power p.
    Power,
    /// Positions of vertices, metres.
    Position,
}

impl Quantity {
    /// Numbers per triangle or vertex.
    pub fn channels(self) -> usize {
        match self {
            Self::Diffuse | Self::Power => 1,
            Self::Emission | Self::Albedo | Self::Specular | Self::Position => 3,
        }
    }

    /// Of its values: "W/(m² sr)", "m", or "1" for plain numbers.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Emission => "W/(m² sr)",
            Self::Position => "m",
            Self::Diffuse | Self::Albedo | Self::Specular | Self::Power => "1",
        }
    }

    /// The word for it in a job file.
    pub fn word(self) -> &'static str {
        match self {
            Self::Emission => "emission",
            Self::Diffuse => "diffuse",
            Self::Albedo => "albedo",
            Self::Specular => "specular",
            Self::Power => "power",
            Self::Position => "position",
        }
    }
}

/// Derivatives of a loss, as far as they were wanted.
///
/// By the values of each triangle's own material (as if no two triangles shared one), and by the position of each
/// vertex; in the order of the scene, per unit of the quantity.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneGradient {
    /// Per triangle, RGB.
    pub emission: Option<Vec<DVec3>>,
    /// Per triangle.
    pub diffuse: Option<Vec<f64>>,
    /// Per triangle, RGB.
    pub albedo: Option<Vec<DVec3>>,
    /// Per triangle, RGB.
    pub specular: Option<Vec<DVec3>>,
    /// Per triangle.
    pub power: Option<Vec<f64>>,
    /// Per vertex.
    pub positions: Option<Vec<DVec3>>,
}

impl SceneGradient {
    /// No derivative at all, of everything wanted.
    pub fn zeros(scene: &Scene, wanted: GradientRequest) -> Self {
        let triangles = scene.triangles.len();
        let rgb = |wanted: bool| wanted.then(|| vec![DVec3::ZERO; triangles]);
        let scalar = |wanted: bool| wanted.then(|| vec![0.0; triangles]);
        Self {
            emission: rgb(wanted.emission),
            diffuse: scalar(wanted.diffuse),
            albedo: rgb(wanted.albedo),
            specular: rgb(wanted.specular),
            power: scalar(wanted.power),
            positions: wanted.positions.then(|| vec![DVec3::ZERO; scene.vertices.len()]),
        }
    }

    /// Adds another gradient, where this one has a place for it.
    pub fn add(&mut self, other: &Self) {
        fn add<T: std::ops::AddAssign + Copy>(to: &mut Option<Vec<T>>, from: &Option<Vec<T>>) {
            if let (Some(to), Some(from)) = (to, from) {
                to.iter_mut().zip(from).for_each(|(to, from)| *to += *from);
            }
        }
        add(&mut self.emission, &other.emission);
        add(&mut self.diffuse, &other.diffuse);
        add(&mut self.albedo, &other.albedo);
        add(&mut self.specular, &other.specular);
        add(&mut self.power, &other.power);
        add(&mut self.positions, &other.positions);
    }

    /// The derivative by a quantity of a triangle's material, in all its channels; zeros where there is none.
    pub fn of_triangle(&self, quantity: Quantity, triangle: usize) -> [f64; 3] {
        let rgb = |of: &Option<Vec<DVec3>>| of.as_ref().map_or([0.0; 3], |of| of[triangle].to_array());
        let scalar = |of: &Option<Vec<f64>>| of.as_ref().map_or([0.0; 3], |of| [of[triangle], 0.0, 0.0]);
        match quantity {
            Quantity::Emission => rgb(&self.emission),
            Quantity::Diffuse => scalar(&self.diffuse),
            Quantity::Albedo => rgb(&self.albedo),
            Quantity::Specular => rgb(&self.specular),
            Quantity::Power => scalar(&self.power),
            Quantity::Position => [0.0; 3],
        }
    }

    /// Adds to the derivative by a quantity of a triangle's material, where there is a place for it.
    pub fn add_to_triangle(&mut self, quantity: Quantity, triangle: usize, value: [f64; 3]) {
        let rgb = |of: &mut Option<Vec<DVec3>>| {
            if let Some(of) = of {
                of[triangle] += DVec3::from(value);
            }
        };
        let scalar = |of: &mut Option<Vec<f64>>| {
            if let Some(of) = of {
                of[triangle] += value[0];
            }
        };
        match quantity {
            Quantity::Emission => rgb(&mut self.emission),
            Quantity::Diffuse => scalar(&mut self.diffuse),
            Quantity::Albedo => rgb(&mut self.albedo),
            Quantity::Specular => rgb(&mut self.specular),
            Quantity::Power => scalar(&mut self.power),
            Quantity::Position => {}
        }
    }
}
