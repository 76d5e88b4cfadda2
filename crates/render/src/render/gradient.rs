//! Derivatives of a loss by the quantities of a scene.

use crate::image::CameraGradient;
use antirad_core::Gradients;
use antirad_core::plan::GradientRequest;
use antirad_scene::{Cut, Scene};
use glam::DVec3;

/// A quantity that can be fitted and differentiated by.
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
    /// Poses of cameras: positions, metres, and rotations, radians.
    Camera,
}

impl Quantity {
    /// Values per triangle, vertex or camera.
    pub fn channels(self) -> usize {
        match self {
            Self::Diffuse | Self::Power => 1,
            Self::Emission | Self::Albedo | Self::Specular | Self::Position => 3,
            Self::Camera => 6,
        }
    }

    /// Unit of its values: "W/(m² sr)", "m", "m, rad", or "1" for dimensionless ones.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Emission => "W/(m² sr)",
            Self::Position => "m",
            Self::Camera => "m, rad",
            Self::Diffuse | Self::Albedo | Self::Specular | Self::Power => "1",
        }
    }

    /// Name of the quantity in a job file.
    pub fn word(self) -> &'static str {
        match self {
            Self::Emission => "emission",
            Self::Diffuse => "diffuse",
            Self::Albedo => "albedo",
            Self::Specular => "specular",
            Self::Power => "power",
            Self::Position => "position",
            Self::Camera => "camera",
        }
    }
}

/// Derivatives of a loss, as far as requested.
///
/// Derivatives are by the values of each triangle's material (as if no two triangles shared one), by the
/// position of each vertex, in scene order, and by each camera, per unit of the quantity.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneGradient {
    /// Per triangle, RGB.
    pub emission: Option<Vec<DVec3>>,
    /// Per sun, by its irradiance, RGB; requested with emission.
    pub suns: Option<Vec<DVec3>>,
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
    /// Per camera of the pictures.
    pub cameras: Option<Vec<CameraGradient>>,
    /// Per [`Painting`](antirad_scene::Painting), by the albedo of its texels; requested with albedo.
    pub texels: Option<Vec<Vec<DVec3>>>,
}

impl SceneGradient {
    /// Zeros for everything requested of triangles and vertices.
    #[doc(hidden)]
    pub fn zeros(scene: &Scene, request: GradientRequest) -> Self {
        let triangles = scene.triangles.len();
        let rgb = |requested: bool| requested.then(|| vec![DVec3::ZERO; triangles]);
        let scalar = |requested: bool| requested.then(|| vec![0.0; triangles]);
        Self {
            emission: rgb(request.emission),
            suns: request.emission.then(|| vec![DVec3::ZERO; scene.suns.len()]),
            diffuse: scalar(request.diffuse),
            albedo: rgb(request.albedo),
            specular: rgb(request.specular),
            power: scalar(request.power),
            positions: request.positions.then(|| vec![DVec3::ZERO; scene.vertices.len()]),
            cameras: None,
            texels: None,
        }
    }

    /// The derivatives by what belongs to the given triangles and vertices of a cut scene, from these, by what belongs to its parts.
    pub fn by_given(self, cut: &Cut) -> Self {
        let rgb = |by: Option<Vec<DVec3>>| by.map(|by| cut.sums(&by));
        let scalar = |by: Option<Vec<f64>>| by.map(|by| cut.sums(&by));
        Self {
            emission: rgb(self.emission),
            diffuse: scalar(self.diffuse),
            albedo: rgb(self.albedo),
            specular: rgb(self.specular),
            power: scalar(self.power),
            positions: self.positions.map(|by| cut.by_given_vertices(&by)),
            ..self
        }
    }

    /// The derivatives by the scene's materials: the same with one entry per material in place of one per triangle, each the
    /// sum over the material's triangles.
    pub fn by_material(&self, scene: &Scene) -> Self {
        fn sums<T: std::ops::AddAssign + Copy + Default>(
            of: &Option<Vec<T>>,
            scene: &Scene,
        ) -> Option<Vec<T>> {
            let mut sums = vec![T::default(); scene.materials.len()];
            for (value, triangle) in of.as_ref()?.iter().zip(&scene.triangles) {
                sums[triangle.material as usize] += *value;
            }
            Some(sums)
        }
        Self {
            emission: sums(&self.emission, scene),
            suns: self.suns.clone(),
            diffuse: sums(&self.diffuse, scene),
            albedo: sums(&self.albedo, scene),
            specular: sums(&self.specular, scene),
            power: sums(&self.power, scene),
            positions: self.positions.clone(),
            cameras: self.cameras.clone(),
            texels: self.texels.clone(),
        }
    }

    /// Adds another gradient, for the quantities that this one has.
    #[doc(hidden)]
    pub fn add(&mut self, other: &Self) {
        fn add<T: std::ops::AddAssign + Copy>(to: &mut Option<Vec<T>>, from: &Option<Vec<T>>) {
            if let (Some(to), Some(from)) = (to, from) {
                to.iter_mut().zip(from).for_each(|(to, from)| *to += *from);
            }
        }
        add(&mut self.emission, &other.emission);
        add(&mut self.suns, &other.suns);
        add(&mut self.diffuse, &other.diffuse);
        add(&mut self.albedo, &other.albedo);
        add(&mut self.specular, &other.specular);
        add(&mut self.power, &other.power);
        add(&mut self.positions, &other.positions);
    }

    /// The derivative by a quantity of a triangle's material, in all its channels; zeros if it was not requested.
    #[doc(hidden)]
    pub fn of_triangle(&self, quantity: Quantity, triangle: usize) -> [f64; 3] {
        let rgb = |of: &Option<Vec<DVec3>>| of.as_ref().map_or([0.0; 3], |of| of[triangle].to_array());
        let scalar = |of: &Option<Vec<f64>>| of.as_ref().map_or([0.0; 3], |of| [of[triangle], 0.0, 0.0]);
        match quantity {
            Quantity::Emission => rgb(&self.emission),
            Quantity::Diffuse => scalar(&self.diffuse),
            Quantity::Albedo => rgb(&self.albedo),
            Quantity::Specular => rgb(&self.specular),
            Quantity::Power => scalar(&self.power),
            Quantity::Position | Quantity::Camera => [0.0; 3],
        }
    }

    /// Adds to the derivative by a quantity of a triangle's material, if it was requested.
    #[doc(hidden)]
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
            Quantity::Position | Quantity::Camera => {}
        }
    }
}

impl From<Gradients> for SceneGradient {
    fn from(gradients: Gradients) -> Self {
        Self {
            emission: gradients.emission,
            suns: gradients.suns,
            diffuse: gradients.diffuse,
            albedo: gradients.albedo,
            specular: gradients.specular,
            power: gradients.power,
            positions: gradients.vertices,
            cameras: gradients.camera_positions.map(|positions| {
                let moved = |position| CameraGradient { position, ..CameraGradient::default() };
                positions.into_iter().map(moved).collect()
            }),
            texels: None,
        }
    }
}
