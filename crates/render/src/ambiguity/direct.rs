//! Direct transport between triangles as a matrix, blockers included.

use super::{AmbiguityError, LightMatrix};
use antirad_base::Watch;
use antirad_core::backend::Backend;
use antirad_core::plan::{Plan, PlanOptions};
use antirad_core::{Engine, Solution, SolveParams};
use antirad_scene::{Lamps, Material, Scene};

/// Irradiance from Lambertian emission, without any reflection: (1 + U J)⁻¹ U.
///
/// Uses the scene's geometry with black materials and solves for three sources at once, one per channel.
pub struct DirectLight {
    engine: Engine,
    scene: Scene,
    params: SolveParams,
}

/// Black, and emitters in red, green and blue.
fn black_materials() -> Vec<Material> {
    let emitting = |emission: [f64; 3]| Material { albedo: [0.0; 3], emission, ..Material::named("source") };
    vec![emitting([0.0; 3]), emitting([1.0, 0.0, 0.0]), emitting([0.0, 1.0, 0.0]), emitting([0.0, 0.0, 1.0])]
}

impl DirectLight {
    /// Plans and allocates an engine. `watch` is called after every pass and can interrupt the solve.
    ///
    /// # Errors
    /// Fails if the scene cannot be planned, or if the backend lacks memory or a feature.
    pub fn new(backend: &Backend, scene: &Scene, watch: &Watch) -> Result<Self, AmbiguityError> {
        let mut scene = Scene { materials: black_materials(), suns: Vec::new(), ..scene.clone() };
        // Each channel occurs once, so that the plan has three.
        for (i, triangle) in scene.triangles.iter_mut().enumerate() {
            triangle.material = if i < 3 { i as u32 + 1 } else { 0 };
        }
        // Every emission takes the same way, that of the matrix.
        let settings = scene.settings.lamps(Lamps::Antiradiance);
        let plan = Plan::new(&scene, &PlanOptions::of(backend), &settings)?;
        let params = SolveParams::from(&scene.settings);
        let mut engine = Engine::new(backend, &scene, plan)?;
        let watch = watch.clone();
        engine.set_pass_callback(Some(Box::new(move |_, _| watch())));
        Ok(Self { engine, scene, params })
    }

    fn solve(&mut self) -> Result<Solution, AmbiguityError> {
        self.engine.set_linear_materials(&self.scene)?;
        Ok(self.engine.solve(&self.params)?)
    }

    /// Irradiance on all triangles, W/m², from `emission` (radiance per triangle, RGB, W/(m² sr)).
    ///
    /// # Errors
    /// Fails if the solve does not converge or `watch` interrupts it, or if the backend fails.
    pub fn irradiance(&mut self, emission: &[[f64; 3]]) -> Result<Vec<[f64; 3]>, AmbiguityError> {
        // Triangles of one colour share a material.
        let mut materials = black_materials();
        materials.truncate(1);
        for (triangle, &rgb) in self.scene.triangles.iter_mut().zip(emission) {
            let known = materials.iter().position(|m| m.emission == rgb);
            triangle.material = known.unwrap_or_else(|| {
                materials.push(Material { emission: rgb, ..materials[0].clone() });
                materials.len() - 1
            }) as u32;
        }
        self.scene.materials = materials;
        Ok(self.solve()?.irradiance)
    }

    /// Irradiance on all triangles (rows) per radiance of each of `sources` (columns), sr. `progress` receives the number of
    /// finished columns.
    ///
    /// # Errors
    /// Fails if a solve does not converge or `watch` interrupts it, or if the backend fails.
    pub fn columns(
        &mut self,
        sources: &[usize],
        progress: &mut dyn FnMut(usize),
    ) -> Result<LightMatrix, AmbiguityError> {
        let mut matrix = LightMatrix::new(self.scene.triangles.len());
        self.scene.materials = black_materials();
        for (batch, three) in sources.chunks(3).enumerate() {
            self.scene.triangles.iter_mut().for_each(|t| t.material = 0);
            for (channel, &source) in three.iter().enumerate() {
                self.scene.triangles[source].material = channel as u32 + 1;
            }
            let irradiance = self.solve()?.irradiance;
            progress(3 * batch + three.len());
            for channel in 0..three.len() {
                matrix.push(irradiance.iter().map(|h| h[channel]));
            }
        }
        Ok(matrix)
    }
}
