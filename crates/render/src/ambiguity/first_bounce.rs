//! Replaces hidden lights by their first bounce.

use super::AmbiguityError;
use super::direct::DirectLight;
use super::views::Views;
use antirad_base::Watch;
use antirad_core::backend::Backend;
use antirad_core::plan::{Plan, PlanOptions};
use antirad_core::{Engine, SolveParams};
use antirad_scene::{Camera, Lamps, Scene};
use glam::DVec3;
use serde::Serialize;
use std::f64::consts::PI;

/// Demonstrates that a scene with hidden lights looks the same without them if its surfaces emit the first bounce of the
/// lights instead: V Γ⁻¹ E = V Γ⁻¹ R E for all E with V E = 0, where V selects the triangles that cameras see, R is direct
/// transport with reflection, and Γ = 1 - R.
#[derive(Clone, Debug, Serialize)]
pub struct FirstBounce {
    /// Emitting triangles that no camera sees.
    pub hidden_lights: Vec<usize>,
    /// Largest difference of a visible face's colour, relative to the brightest visible colour.
    pub largest_difference: f64,
    /// Relative L2 difference of the pixels.
    pub picture_difference: f64,
    /// Number of triangles with a specular lobe: their first bounce is directional, but the Lambertian emission that replaces
    /// it is not.
    pub glossy: usize,
    /// The replacement emission per triangle, RGB, W/(m² sr).
    #[serde(skip)]
    pub emission: Vec<[f64; 3]>,
}

impl FirstBounce {
    /// Renders both scenes and compares them; `None` if no light is hidden.
    ///
    /// # Errors
    /// Fails if the scene cannot be planned, if a solve does not converge or `watch` interrupts it, or if the
    /// backend fails.
    pub fn new(
        backend: &Backend,
        scene: &Scene,
        cameras: &[&Camera],
        views: &Views,
        direct: &mut DirectLight,
        watch: &Watch,
    ) -> Result<Option<Self>, AmbiguityError> {
        let emits = |i: usize| scene.material(i).emission.iter().any(|&e| e > 0.0);
        let hidden_lights: Vec<usize> = views.unseen(scene).into_iter().filter(|&i| emits(i)).collect();
        if hidden_lights.is_empty() {
            return Ok(None);
        }
        let mut hidden = vec![[0.0; 3]; scene.triangles.len()];
        for &light in &hidden_lights {
            hidden[light] = scene.material(light).emission;
        }
        let irradiance = direct.irradiance(&hidden)?;
        let emission: Vec<[f64; 3]> = (0..scene.triangles.len())
            .map(|i| {
                let material = scene.material(i);
                let rest = DVec3::from(material.emission) - DVec3::from(hidden[i]);
                let bounce = DVec3::from(material.diffuse_albedo()) * DVec3::from(irradiance[i]) / PI;
                (rest + bounce).to_array()
            })
            .collect();

        // A lamp and its first bounce are to be compared, so both take the same way.
        let settings = scene.settings.lamps(Lamps::Antiradiance);
        let plan = Plan::new(scene, &PlanOptions::of(backend), &settings)?;
        let mut engine = Engine::new(backend, scene, plan)?;
        let watch = watch.clone();
        engine.set_pass_callback(Some(Box::new(move |_, _| watch())));
        let truth = shown(&mut engine, scene, cameras)?;
        // The bounce may be slightly negative: discretised antiradiance can remove more light than there is.
        engine.set_linear_materials(&scene.with_emission(&emission))?;
        let instead = shown(&mut engine, scene, cameras)?;
        let (mut largest, mut brightest) = (0.0, 0.0);
        let (mut squared, mut power) = (0.0, 0.0);
        for (coverage, (truth, instead)) in views.coverage.iter().zip(truth.iter().zip(&instead)) {
            for face in coverage.faces() {
                let (a, b) = (DVec3::from(truth[face]), DVec3::from(instead[face]));
                largest = f64::max(largest, (a - b).abs().max_element());
                brightest = f64::max(brightest, a.abs().max_element());
            }
            for (a, b) in coverage.pixels(truth)?.iter().zip(coverage.pixels(instead)?) {
                squared += (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>();
                power += (0..3).map(|c| a[c].powi(2)).sum::<f64>();
            }
        }
        Ok(Some(Self {
            hidden_lights,
            largest_difference: largest / brightest,
            picture_difference: (squared / power).sqrt(),
            glossy: (0..scene.triangles.len()).filter(|&i| scene.material(i).is_glossy()).count(),
            emission,
        }))
    }
}

/// The colours of all faces, by camera.
fn shown(
    engine: &mut Engine,
    scene: &Scene,
    cameras: &[&Camera],
) -> Result<Vec<Vec<[f64; 3]>>, AmbiguityError> {
    let solution = engine.solve(&SolveParams::from(&scene.settings))?;
    let look = |camera: &&Camera| Ok(engine.face_colours(&solution, camera.position)?);
    cameras.iter().map(look).collect()
}
