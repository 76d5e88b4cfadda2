//! Looks into a scene with a few rays: places the automatic camera where it sees fronts, and finds out why a picture would be black
//! or empty.

use glam::DVec3;
use std::sync::Arc;

use super::orient::spread;
use super::{Camera, Rays, Scene, bounds};

/// Rays along a side of a picture.
const GRID: u32 = 16;
/// Scenes of more triangles are not looked into: it would take seconds.
pub(super) const MOST: usize = 2_000_000;
/// Share of what a camera meets that must be fronts.
const ENOUGH: f64 = 0.5;
/// Below this share, next to nothing of a picture shows fronts.
const HARDLY: f64 = 0.02;
/// A lamp this much closer to what it faces than to what is behind it faces the wrong way.
const CLOSE: f64 = 0.02;
/// Field of view inside a room.
const WIDE_DEGREES: f64 = 75.0;

/// What the rays of a camera meet, as shares of all rays.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    fronts: f64,
    backs: f64,
    /// Mean over all rays of the distance to fronts, over the size of the scene and at most 1.
    depth: f64,
}

impl Seen {
    /// Whether a picture is worth taking: something is seen, and most of it from its front.
    fn enough(&self) -> bool {
        self.fronts > 0.0 && self.fronts >= ENOUGH * (self.fronts + self.backs)
    }
}

pub(super) struct Outlook<'a> {
    scene: &'a Scene,
    rays: Arc<Rays>,
    low: DVec3,
    high: DVec3,
}

impl<'a> Outlook<'a> {
    /// Requires [`Scene::degenerate`] to be up to date.
    pub fn new(scene: &'a Scene) -> Self {
        let (low, high) =
            bounds(scene.triangles.iter().flat_map(|t| t.vertices).map(|v| scene.vertices[v as usize]));
        Self { scene, rays: scene.rays(), low, high }
    }

    fn look(&self, camera: &Camera) -> Seen {
        let Some(view) = (camera.target - camera.position).try_normalize() else { return Seen::default() };
        let Some(right) = view.cross(camera.up).try_normalize() else { return Seen::default() };
        let up = right.cross(view);
        let half = (camera.fov_x_degrees / 2.0).to_radians().tan();
        let aspect = f64::from(camera.height) / f64::from(camera.width.max(1));
        let at = |k: u32| 2.0 * (f64::from(k) + 0.5) / f64::from(GRID) - 1.0;
        let size = (self.high - self.low).max_element();
        let mut seen = Seen::default();
        for (row, column) in (0..GRID).flat_map(|row| (0..GRID).map(move |column| (row, column))) {
            let direction = (view + right * (half * at(column)) + up * (half * aspect * at(row))).normalize();
            if let Some((triangle, distance)) = self.rays.nearest(camera.position, direction, None) {
                if self.scene.area_vector(triangle).dot(direction) < 0.0 {
                    seen.fronts += 1.0;
                    seen.depth += (distance / size).min(1.0);
                } else {
                    seen.backs += 1.0;
                }
            }
        }
        let all = f64::from(GRID * GRID);
        Seen { fronts: seen.fronts / all, backs: seen.backs / all, depth: seen.depth / all }
    }

    /// A camera named "auto": it frames the scene from the front (+z), or else from the first side that shows mostly fronts, or else
    /// it stands inside, where it sees the deepest into the room.
    pub fn camera(&self) -> Camera {
        let framing = Camera::framing(&self.scene.vertices);
        let offset = framing.position - framing.target;
        let sides = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]].map(|[cos, sin]| {
            DVec3::new(cos * offset.x + sin * offset.z, offset.y, cos * offset.z - sin * offset.x)
        });
        let above = [offset, DVec3::new(offset.x, offset.length(), offset.z * 0.3), -offset];
        for offset in sides.into_iter().chain(above) {
            let camera = Camera { position: framing.target + offset, ..framing.clone() };
            if self.look(&camera).enough() {
                return camera;
            }
        }
        self.inside(&framing).unwrap_or(framing)
    }

    /// The place on a grid, and the view from there to the middle of the scene, that shows fronts at the greatest depth.
    fn inside(&self, framing: &Camera) -> Option<Camera> {
        let size = self.high - self.low;
        let across = [0.93, 0.07, 0.75, 0.25, 0.5];
        let mut best: Option<(f64, Camera)> = None;
        for z in across {
            for x in across {
                for y in [0.5, 0.7, 0.3] {
                    let position = self.low + size * DVec3::new(x, y, z);
                    let ahead = framing.target - position;
                    let target = if ahead.length() > 0.2 * size.max_element() {
                        framing.target
                    } else {
                        position - DVec3::Z * size.z
                    };
                    let camera = Camera { position, target, fov_x_degrees: WIDE_DEGREES, ..framing.clone() };
                    let seen = self.look(&camera);
                    let better = best.as_ref().is_none_or(|(depth, _)| seen.depth > *depth);
                    if seen.enough() && better && camera.check().is_ok() {
                        best = Some((seen.depth, camera));
                    }
                }
            }
        }
        best.map(|(_, camera)| camera)
    }

    /// Why pictures would be black or empty, as far as rays can tell.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = self.lamps_that_face_away();
        for camera in &self.scene.cameras {
            let seen = self.look(camera);
            let name = &camera.name;
            if seen.fronts + seen.backs == 0.0 {
                warnings.push(format!(
                    "Camera \"{name}\" sees nothing: it stands at ({:.3}, {:.3}, {:.3}) and the scene reaches from ({:.3}, {:.3}, \
                     {:.3}) to ({:.3}, {:.3}, {:.3}); move it or its target.",
                    camera.position.x,
                    camera.position.y,
                    camera.position.z,
                    self.low.x,
                    self.low.y,
                    self.low.z,
                    self.high.x,
                    self.high.y,
                    self.high.z
                ));
            } else if seen.fronts < HARDLY {
                warnings.push(format!(
                    "Camera \"{name}\" sees hardly anything but the backs of triangles, which are black: move it to the other side, or \
                     set `two_sided = true` (--two-sided)."
                ));
            }
        }
        warnings
    }

    /// Lamps whose light goes nowhere while there is something to light behind them, by mesh.
    fn lamps_that_face_away(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        for mesh in &self.scene.meshes {
            let lamps: Vec<usize> =
                mesh.range.clone().map(|t| t as usize).filter(|&t| self.scene.shines(t)).collect();
            if lamps.is_empty() {
                continue;
            }
            let [front, back] = [1.0, -1.0].map(|side| self.reach(&lamps, side));
            let how = match (front, back) {
                (Reach { share: 0.0, .. }, Reach { share, .. }) if share > 0.0 => "nothing".to_owned(),
                (front, back) if front.share > 0.5 && front.distance < CLOSE * back.distance => {
                    format!("a surface {:.3e} m away", front.distance)
                }
                _ => continue,
            };
            warnings.push(format!(
                "The lamps of mesh \"{}\" face {how}, and the scene is behind them: their light will be missing. Turn their faces (swap \
                 two corners of each), or set `two_sided = true` (--two-sided).",
                mesh.name
            ));
        }
        warnings
    }

    fn reach(&self, lamps: &[usize], side: f64) -> Reach {
        let mut distances = Vec::new();
        let mut all = 0.0;
        for &lamp in spread(lamps) {
            for (direction, point) in self.scene.rays_from(lamp, side) {
                all += 1.0;
                distances
                    .extend(self.rays.nearest(point, direction, Some(lamp)).map(|(_, distance)| distance));
            }
        }
        distances.sort_by(f64::total_cmp);
        let distance = distances.get(distances.len() / 2).copied().unwrap_or(0.0);
        Reach { share: distances.len() as f64 / f64::max(all, 1.0), distance }
    }
}

/// How far the light of lamps goes: the share of rays that meet a surface, and their median length, m.
struct Reach {
    share: f64,
    distance: f64,
}
