//! Errors of gradients over the step of the differences.

use crate::Interrupted;
use crate::kind::{Kind, Sample, Shape};
use crate::loss::{self, Loss, Values};
use crate::table::Row;
use antirad::backend::Backend;
use antirad::cli::Interrupt;
use antirad::plan::GradientRequest;
use antirad::scene::Scene;
use antirad::{Engine, Solution};
use glam::DVec3;
use indicatif::ProgressBar;
use std::error::Error;

/// 1e-1 to 1e-8.
const STEPS: i32 = 8;
/// Cost of a solve in units of evaluating the loss of a solution.
const SOLVE_COST: u64 = 50;

/// A fixed subset: triangles at equal intervals in the scene's order, and the first vertex of each; glossy ones for the
/// parameters of the lobe; both cameras.
pub fn samples(scene: &Scene, kinds: &[Kind], count: usize) -> Vec<Sample> {
    let valid = |i: &usize| !scene.degenerate.contains(&(*i as u32));
    let all: Vec<usize> = (0..scene.triangles.len()).filter(valid).collect();
    let glossy: Vec<usize> = all.iter().copied().filter(|&i| scene.material(i).is_glossy()).collect();
    let spread = |from: &[usize]| -> Vec<usize> {
        let count = count.min(from.len());
        (0..count).map(|k| from[(2 * k + 1) * from.len() / (2 * count)]).collect()
    };
    let mut samples = Vec::new();
    for &kind in kinds {
        let mut indices = match kind {
            Kind::Specular | Kind::Power => spread(&glossy),
            Kind::Camera => vec![0, 1],
            Kind::Vertex => spread(&all).iter().map(|&i| scene.triangles[i].vertices[0] as usize).collect(),
            _ => spread(&all),
        };
        indices.dedup();
        samples.extend(indices.into_iter().map(|index| Sample { kind, index }));
    }
    samples
}

/// One mesh.
pub struct Bench<'a> {
    pub mesh: &'static str,
    pub scene: Scene,
    pub samples: Vec<Sample>,
    pub backend: &'a Backend,
    pub interrupt: &'a Interrupt,
}

impl Bench<'_> {
    /// Rough cost of the mesh, in units of evaluating the loss.
    pub fn cost(&self) -> u64 {
        let of_sample = |sample: &Sample| match sample.kind {
            Kind::Camera => 6,
            _ => 2 * SOLVE_COST,
        };
        10 * SOLVE_COST + STEPS as u64 * self.samples.iter().map(of_sample).sum::<u64>()
    }

    pub fn run(&self, bar: &ProgressBar) -> Result<Vec<Row>, Box<dyn Error>> {
        let mut progress = |_: u32, _: f64| self.interrupt.flow();
        let camera_positions = loss::camera_positions(&self.scene);
        let loss = Loss::new(self.scene.triangles.len());
        bar.set_message(format!("{} mesh: gradients", self.mesh));
        let mut engine = loss::engine(self.backend, &self.scene, GradientRequest::EVERYTHING)?;
        let solution = engine.solve_with(&loss::params(), &mut progress)?;
        let gradients = loss::gradients(&mut engine, &solution, &loss, camera_positions, &mut progress)?;
        bar.inc(10 * SOLVE_COST);
        tracing::info!("{} mesh: {} and {} passes", self.mesh, solution.info.passes, gradients.info.passes);

        let mut rows = Vec::new();
        for &kind in &Kind::ALL {
            let samples: Vec<Sample> = self.samples.iter().copied().filter(|s| s.kind == kind).collect();
            // Per step of 1.
            let found: Vec<DVec3> = samples
                .iter()
                .map(|s| {
                    let per_step = s.gradient(&gradients)? * s.size(&self.scene, &camera_positions);
                    Some(match kind.shape() {
                        Shape::Direction => DVec3::new(per_step.dot(s.direction()), 0.0, 0.0),
                        _ => per_step,
                    })
                })
                .collect::<Option<_>>()
                .ok_or("gradients are missing: a bug in antirad")?;
            for power in 1..=STEPS {
                let step = 10.0_f64.powi(-power);
                let at = format!("{} mesh: {}, ε = 1e-{power}", self.mesh, kind.name());
                for (sample, gradient) in samples.iter().zip(&found) {
                    bar.set_message(at.clone());
                    let slope = self.slope(sample, step, &loss, (&mut engine, &solution), bar)?;
                    let row = Row {
                        mesh: self.mesh.to_owned(),
                        bins: self.scene.settings.bins.to_string(),
                        kind,
                        index: sample.index,
                        step,
                        gradient: gradient.length(),
                        slope: slope.length(),
                        difference: slope.distance(*gradient),
                    };
                    tracing::debug!("{at}: {:.1e} of {:.1e}", row.error(), row.gradient);
                    rows.push(row);
                }
            }
        }
        Ok(rows)
    }

    /// The central difference, per step of 1.
    fn slope(
        &self,
        sample: &Sample,
        step: f64,
        loss: &Loss,
        base: (&mut Engine, &Solution),
        bar: &ProgressBar,
    ) -> Result<DVec3, Box<dyn Error>> {
        let (engine, solution) = base;
        let camera_positions = loss::camera_positions(&self.scene);
        let size = sample.size(&self.scene, &camera_positions);
        let mut at = |by: DVec3| -> Result<Values, Box<dyn Error>> {
            if self.interrupt.is_set() {
                return Err(Interrupted.into());
            }
            let (scene, camera_positions) = sample.changed(&self.scene, camera_positions, by);
            if sample.kind == Kind::Camera {
                bar.inc(1);
                return Ok(Values::of(engine, solution, camera_positions)?);
            }
            let mut engine = if sample.kind == Kind::Emission {
                // Below zero on one side of a dark triangle.
                let mut engine = loss::engine(self.backend, &self.scene, GradientRequest::NOTHING)?;
                engine.set_linear_materials(&scene)?;
                engine
            } else {
                loss::engine(self.backend, &scene, GradientRequest::NOTHING)?
            };
            let moved =
                engine.solve_from(Some(solution), &loss::params(), &mut |_, _| self.interrupt.flow())?;
            bar.inc(SOLVE_COST);
            Ok(Values::of(&mut engine, &moved, camera_positions)?)
        };
        let mut difference = |by: DVec3| -> Result<DVec3, Box<dyn Error>> {
            Ok(loss.of_difference(&at(by)?, &at(-by)?) / (2.0 * step))
        };
        match sample.kind.shape() {
            Shape::Rgb => difference(step * size),
            Shape::Scalar => Ok(DVec3::new(difference(step * size)?.element_sum(), 0.0, 0.0)),
            Shape::Direction => {
                let slope = difference(step * size * sample.direction())?;
                Ok(DVec3::new(slope.element_sum(), 0.0, 0.0))
            }
            Shape::Position => {
                let mut slope = DVec3::ZERO;
                for (k, axis) in DVec3::AXES.into_iter().enumerate() {
                    slope[k] = difference(step * size * axis)?.element_sum();
                }
                Ok(slope)
            }
        }
    }
}
