//! Triangles so close to lamps that much of the light falls onto one, from which it would leave evenly.

use crate::direct::{Lamp, Polygon, lamps, vector_irradiance};
use crate::model::{Facet, coplanar_tolerance};
use crate::plan::Placement;
use antirad_base::parallel;
use antirad_scene::Scene;
use glam::DVec3;
use std::f64::consts::PI;

/// Share of the light of lamps that one triangle may receive: that of a triangle about half as wide as it is far from the only lamp.
const MOST_OF_THE_LIGHT: f64 = 0.04;

/// Triangles that would receive more than 4 % of all light of lamps other than suns if nothing stood between and all were equally bright,
/// ascending.
pub(super) fn flooded(scene: &Scene) -> Vec<u32> {
    let facets = Placement::of(scene).facets(scene);
    let lamps = lamps(scene, &facets, coplanar_tolerance(&facets));
    let emitted = Emitted::new(scene, &facets, &lamps);
    let all = 0..facets.len() as u32;
    parallel::filter(all, |&i| emitted.share(i as usize) > MOST_OF_THE_LIGHT)
}

/// The light that lamps other than suns emit if all are equally bright, as if nothing stood in its way.
struct Emitted<'a> {
    scene: &'a Scene,
    facets: &'a [Facet],
    lamps: Vec<Source>,
    power: f64,
}

/// A lamp as points between its centre and its corners, or as its centre alone if it is a solid.
struct Source {
    /// None of a solid, which shines all around.
    normal: Option<DVec3>,
    power: f64,
    points: Vec<DVec3>,
}

impl<'a> Emitted<'a> {
    fn new(scene: &'a Scene, facets: &'a [Facet], lamps: &[Lamp]) -> Self {
        // Suns light all of a triangle alike.
        let source = |lamp: &Polygon| {
            let corner = |&[i, k]: &[u32; 2]| facets[i as usize].corners[k as usize];
            let corners: Vec<DVec3> = lamp.corners.iter().map(corner).collect();
            let centre = corners.iter().sum::<DVec3>() / corners.len() as f64;
            let area: f64 = lamp.triangles.iter().map(|&i| facets[i as usize].area).sum();
            let solid = lamp.solid.is_some();
            Source {
                normal: (!solid).then(|| facets[lamp.first()].normal),
                power: area,
                points: match solid {
                    true => vec![centre],
                    false => corners.iter().map(|corner| 0.5 * (corner + centre)).collect(),
                },
            }
        };
        let lamps: Vec<Source> = lamps.iter().filter_map(Lamp::surface).map(source).collect();
        Self { scene, facets, power: lamps.iter().map(|lamp| lamp.power).sum(), lamps }
    }

    /// The share that a triangle receives, by form factors from the points of lamps; none if it reflects nothing.
    fn share(&self, triangle: usize) -> f64 {
        let receiver = &self.facets[triangle];
        if self.lamps.is_empty() || self.scene.material(triangle).diffuse_albedo() == [0.0; 3] {
            return 0.0;
        }
        let form_factor = |point: DVec3, normal: Option<DVec3>| {
            let sides = (0..3).map(|k| (0, [k, (k + 1) % 3].map(|k| receiver.corners[k] - point)));
            // Seen from its front, a triangle runs the other way than the cone that it closes.
            let flux = vector_irradiance(sides);
            normal.map_or(flux.length() / (4.0 * PI), |normal| (-flux.dot(normal) / PI).max(0.0))
        };
        let from = |lamp: &Source| {
            let faces = |point: &&DVec3| (**point - receiver.centroid).dot(receiver.normal) > 0.0;
            let sum: f64 = lamp.points.iter().filter(faces).map(|p| form_factor(*p, lamp.normal)).sum();
            lamp.power * sum / lamp.points.len() as f64
        };
        self.lamps.iter().map(from).sum::<f64>() / self.power
    }
}
