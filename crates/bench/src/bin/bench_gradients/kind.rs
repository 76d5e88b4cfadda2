//! The kinds of parameters: how one is changed, by how much, and which gradient belongs to it.

use crate::room::{bounds, mean_edge};
use antirad::Gradients;
use antirad::scene::{Material, Scene, Triangle};
use antirad_kit::Random;
use glam::DVec3;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    Emission,
    Albedo,
    Diffuse,
    Specular,
    Power,
    Centroid,
    Vertex,
    Camera,
}

/// Three numbers, and how the loss depends on them.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// One per channel. Channels are independent, so all three are changed at once.
    Rgb,
    /// One number, which all channels depend on.
    Scalar,
    /// A position, changed along one fixed random direction, since every axis would take solves of its own.
    Direction,
    /// A position, one axis after another.
    Position,
}

/// One parameter. `index` is that of a triangle, vertex or camera.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    pub kind: Kind,
    pub index: usize,
}

impl Kind {
    pub const ALL: [Self; 8] = [
        Self::Emission,
        Self::Albedo,
        Self::Diffuse,
        Self::Specular,
        Self::Power,
        Self::Centroid,
        Self::Vertex,
        Self::Camera,
    ];

    pub fn shape(self) -> Shape {
        match self {
            Self::Emission | Self::Albedo | Self::Specular => Shape::Rgb,
            Self::Diffuse | Self::Power => Shape::Scalar,
            Self::Centroid | Self::Vertex => Shape::Direction,
            Self::Camera => Shape::Position,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Emission => "emission",
            Self::Albedo => "albedo",
            Self::Diffuse => "diffuse δ",
            Self::Specular => "specular σ",
            Self::Power => "power p",
            Self::Centroid => "centroid",
            Self::Vertex => "vertex",
            Self::Camera => "camera",
        }
    }

    /// Bound of the error at the best step, on a jittered and on a regular mesh.
    pub fn target(self, mesh: &str) -> Option<f64> {
        match (self, mesh) {
            (Self::Emission, "jittered") => Some(1e-10),
            (Self::Albedo, "jittered") => Some(1e-9),
            (_, "jittered") => Some(1e-7),
            (Self::Centroid | Self::Vertex, _) => Some(1e-5),
            _ => None,
        }
    }
}

impl Sample {
    /// The size of a step of 1, per channel or axis.
    pub fn size(&self, scene: &Scene, camera_positions: &[DVec3]) -> DVec3 {
        let material = || scene.material(self.index);
        match self.kind {
            Kind::Emission => {
                let used = (0..scene.triangles.len()).map(|i| scene.material(i).emission);
                let highest = used.flatten().fold(0.0, f64::max);
                DVec3::splat(if highest > 0.0 { highest } else { 1.0 })
            }
            Kind::Albedo | Kind::Diffuse => DVec3::ONE,
            Kind::Specular => material().specular.map(|s| if s > 0.0 { s } else { 1.0 }).into(),
            Kind::Power => DVec3::splat(if material().power > 0.0 { material().power } else { 1.0 }),
            Kind::Centroid => DVec3::splat(mean_edge(scene, self.index)),
            Kind::Vertex => {
                let uses = |t: &&Triangle| t.vertices.contains(&(self.index as u32));
                let around: Vec<f64> = (0..scene.triangles.len())
                    .filter(|&i| uses(&&scene.triangles[i]))
                    .map(|i| mean_edge(scene, i))
                    .collect();
                DVec3::splat(around.iter().sum::<f64>() / around.len().max(1) as f64)
            }
            Kind::Camera => DVec3::splat(camera_positions[self.index].distance(bounds(scene).0)),
        }
    }

    /// The direction in which a position is moved: unit, the same on every run.
    pub fn direction(&self) -> DVec3 {
        Random::new(self.index as u64 + 1000).direction()
    }

    /// The scene and the cameras with this parameter changed.
    pub fn changed(&self, scene: &Scene, camera_positions: [DVec3; 2], by: DVec3) -> (Scene, [DVec3; 2]) {
        let (mut scene, mut camera_positions) = (scene.clone(), camera_positions);
        // Give the triangle a material of its own.
        let mut with_material = |change: &dyn Fn(&mut Material)| {
            let mut material = scene.material(self.index).clone();
            change(&mut material);
            scene.triangles[self.index].material = scene.materials.len() as u32;
            scene.materials.push(material);
        };
        let add = |to: &mut [f64; 3]| *to = (DVec3::from(*to) + by).to_array();
        match self.kind {
            Kind::Emission => with_material(&|m| add(&mut m.emission)),
            Kind::Albedo => with_material(&|m| add(&mut m.albedo)),
            Kind::Diffuse => with_material(&|m| m.diffuse += by.x),
            Kind::Specular => with_material(&|m| add(&mut m.specular)),
            Kind::Power => with_material(&|m| m.power += by.x),
            // Detach it from its neighbours: give it vertices of its own.
            Kind::Centroid => {
                let first = scene.vertices.len() as u32;
                scene.vertices.extend(scene.corners(self.index).map(|x| x + by));
                scene.triangles[self.index].vertices = [first, first + 1, first + 2];
            }
            Kind::Vertex => scene.vertices[self.index] += by,
            Kind::Camera => camera_positions[self.index] += by,
        }
        (scene, camera_positions)
    }

    /// Per unit of the parameter; `None` where it was not computed.
    pub fn gradient(&self, gradients: &Gradients) -> Option<DVec3> {
        let i = self.index;
        let first = |x: f64| DVec3::new(x, 0.0, 0.0);
        Some(match self.kind {
            Kind::Emission => gradients.emission.as_ref()?[i],
            Kind::Albedo => gradients.albedo.as_ref()?[i],
            Kind::Diffuse => first(gradients.diffuse.as_ref()?[i]),
            Kind::Specular => gradients.specular.as_ref()?[i],
            Kind::Power => first(gradients.power.as_ref()?[i]),
            Kind::Centroid => gradients.corners.as_ref()?[i].iter().sum(),
            Kind::Vertex => gradients.vertices.as_ref()?[i],
            Kind::Camera => gradients.camera_positions.as_ref()?[i],
        })
    }
}
