//! Stages of a fit in smaller pictures. Of textures before their texels: one albedo for each, and which candidates for lamps shine. Of poses: to
//! come near enough.

use super::job::{FitError, FitProgress, Job, Record, advance, before_the_first};
use super::optimiser::{CoarseHessian, Optimiser, StepError};
use super::problem::Problem;
use super::regulariser::{Regulariser, Regularisers};
use super::renderer::Renderer;
use super::settings::StopRule;
use super::target::Target;
use antirad_base::parallel;
use std::ops::{ControlFlow, Range};
use std::sync::Arc;

/// Pictures of a Gauss-Newton Hessian, and when a stage ends.
const PICTURES: usize = 40;
const ITERATIONS: u32 = 12;
/// The same where poses are unknown: what a candidate for a lamp explains is told from edges that are off only once these have been found.
const ITERATIONS_WITH_POSES: u32 = 40;
const DECREASE: f64 = 1e-2;
/// Share of the loss that a candidate for a lamp must explain.
const DARK: f64 = 1e-2;
/// Pixels of all views together above which pictures are averaged down: albedos of whole meshes and lamps need no more.
const PIXELS: usize = 250_000;

/// Sides of a picture below which it is not averaged down, pixels.
const SIDE: u32 = 32;

/// By how much pictures are averaged down to find poses, one after the other.
const LEVELS: [u32; 3] = [8, 4, 2];

/// Sides of the smallest of these pictures, and most iterations in each: what is left is found faster in larger ones.
const SIDE_OF_LEVEL: u32 = 48;
const ITERATIONS_OF_LEVEL: u32 = 6;

impl Job {
    /// Where a fit of textures starts, and the Hessian there: with one albedo for each, and everything else, fitted before. Texels of a mesh
    /// and its lamps act on pictures together, which an optimiser of many unknowns learns slowly.
    pub(super) fn coarse_start(
        &mut self,
        x: &[f64],
        renderer: &mut dyn Renderer,
        watch: &mut dyn FnMut(&Record, &FitProgress) -> ControlFlow<()>,
    ) -> Result<(Vec<f64>, Option<CoarseHessian>), FitError> {
        tracing::info!("first with one albedo for each texture");
        let (coarse, of) = self.problem.coarse(x, &self.settings.regularisers)?;
        let (optimiser, dark) = self.with(coarse, |job| job.coarse(renderer, watch))?;
        dark.into_iter().for_each(|block| self.problem.parameters.hold_at_zero(block));
        let x = of.iter().map(|&z| optimiser.best()[z as usize]).collect();
        Ok((x, optimiser.hessian().map(|hessian| CoarseHessian { of, hessian })))
    }

    /// Where a fit of poses starts: those found in smaller pictures, from small to large (Bergen, Anandan, Hanna and Hingorani 1992). An edge
    /// in a photo tells where that of the scene belongs from about a pixel away alone.
    pub(super) fn coarse_poses(
        &mut self,
        x: &[f64],
        renderer: &mut dyn Renderer,
        watch: &mut dyn FnMut(&Record, &FitProgress) -> ControlFlow<()>,
    ) -> Result<(Vec<f64>, Option<CoarseHessian>), FitError> {
        let parameters = &self.problem.parameters;
        let only_poses =
            parameters.poses().iter().map(|pose| pose.unknowns.len()).sum::<usize>() == parameters.len();
        let (mut x, mut known) = (x.to_vec(), None);
        for level in LEVELS {
            let smaller = halved(&self.problem.targets, level);
            let Some(smaller) = smaller.filter(|smaller| self.problem.loss.of_targets(smaller).is_some())
            else {
                continue;
            };
            tracing::info!("first in pictures of a {level}th of the width");
            let (coarse, of) = self.problem.with_smaller(smaller, &x, &self.settings.regularisers)?;
            let (best, hessian) = self.with(coarse, |job| {
                let mut best = job.problem.parameters.start().to_vec();
                let mut hessian = None;
                if !only_poses {
                    let found = job.few_steps(job.new_optimiser(), ITERATIONS_OF_LEVEL, renderer, watch)?;
                    best = found.optimiser.best().to_vec();
                    hessian = found.optimiser.hessian();
                }
                Ok((job.with_poses(&best, renderer, watch)?, hessian))
            })?;
            x = of.iter().map(|&z| best[z as usize]).collect();
            known = hessian.map(|hessian| CoarseHessian { of, hessian });
        }
        if only_poses {
            x = self.with_poses(&x, renderer, watch)?;
        }
        Ok((x, known))
    }

    /// The unknowns with each pose nearer to where its pictures say that it is.
    fn with_poses(
        &self,
        x: &[f64],
        renderer: &mut dyn Renderer,
        watch: &mut dyn FnMut(&Record, &FitProgress) -> ControlFlow<()>,
    ) -> Result<Vec<f64>, FitError> {
        let progress = FitProgress::new(self.new_optimiser());
        let found = self.problem.with_poses(x, renderer, &mut |record| watch(&record, &progress));
        found.map_err(before_the_first)
    }

    /// What is found with another objective, of fewer unknowns or pixels, for which a Gauss-Newton Hessian may take more pictures.
    fn with<T>(
        &mut self,
        problem: Problem,
        find: impl FnOnce(&Self) -> Result<T, FitError>,
    ) -> Result<T, FitError> {
        let settings = self.settings.clone().gauss_newton(self.settings.gauss_newton.max(PICTURES));
        let problem = std::mem::replace(&mut self.problem, problem);
        let settings = std::mem::replace(&mut self.settings, settings);
        let found = find(self);
        (self.problem, self.settings) = (problem, settings);
        found
    }

    /// The optimiser after a few steps, and the blocks of candidates for lamps that are dark: without which the pictures are explained as well.
    fn coarse(
        &self,
        renderer: &mut dyn Renderer,
        watch: &mut dyn FnMut(&Record, &FitProgress) -> ControlFlow<()>,
    ) -> Result<(Optimiser, Vec<usize>), FitError> {
        let poses = self.problem.parameters.gradient_request().camera;
        let iterations = if poses { ITERATIONS_WITH_POSES } else { ITERATIONS };
        let mut best = self.few_steps(self.new_optimiser(), iterations, renderer, watch)?;
        if let Optimiser::QuasiNewton(optimiser) = &mut best.optimiser {
            // That of earlier steps is no longer that of this point.
            let hessian = self.problem.gauss_newton(optimiser.x(), renderer).map_err(before_the_first)?;
            hessian.iter().for_each(|hessian| optimiser.set_hessian(hessian));
        }
        let mut candidates = self.problem.parameters.candidates();
        let mut dark = Vec::new();
        while let Optimiser::QuasiNewton(optimiser) = &best.optimiser {
            let loss = best.loss();
            let without = |(at, (_, name, unknowns)): (usize, &(usize, &str, Range<usize>))| {
                let (increase, trial) = optimiser.without(unknowns.clone())?;
                tracing::info!(
                    "without light of {name} the loss is expected {:.2} % higher",
                    100.0 * increase / loss
                );
                (increase <= DARK * loss).then_some((at, increase, trial))
            };
            let trials = candidates.iter().enumerate().filter_map(without);
            let Some((at, _, trial)) = trials.min_by(|(_, a, _), (_, b, _)| a.total_cmp(b)) else { break };
            let trial = self.few_steps(Optimiser::QuasiNewton(trial), iterations, renderer, watch)?;
            let (block, name, _) = candidates.remove(at);
            if trial.loss() <= (1.0 + DARK) * loss {
                tracing::info!("{name} does not shine: pictures are explained as well without its light");
                dark.push(block);
                best = trial;
            }
        }
        Ok((best.optimiser, dark))
    }

    /// The progress of an optimiser until steps become small.
    fn few_steps(
        &self,
        optimiser: Optimiser,
        iterations: u32,
        renderer: &mut dyn Renderer,
        watch: &mut dyn FnMut(&Record, &FitProgress) -> ControlFlow<()>,
    ) -> Result<FitProgress, FitError> {
        let rule = StopRule::default().iterations(iterations).relative_decrease(DECREASE);
        let mut progress = FitProgress::new(optimiser);
        while progress.stop(&rule).is_none() {
            let record = advance(&self.problem, &self.settings, None, &mut progress, renderer);
            let record = record.map_err(|error| match error {
                StepError::Objective(error) => before_the_first(error),
                error => FitError::Optimiser(error.to_string()),
            })?;
            let Some(record) = record else { break };
            if watch(&Record { first_stage: true, ..record }, &progress).is_break() {
                return Err(FitError::Interrupted { iteration: 0 });
            }
        }
        Ok(progress)
    }
}

impl Problem {
    /// The objective with one albedo for each texture, of smaller pictures, starting at a point; and per unknown, the one of it that it
    /// follows.
    fn coarse(&self, x: &[f64], regularisers: &[Regulariser]) -> Result<(Self, Vec<u32>), FitError> {
        self.with_smaller(averaged_down(&self.targets), x, regularisers)
    }

    /// The same with these smaller pictures.
    fn with_smaller(
        &self,
        smaller: Vec<Target>,
        x: &[f64],
        regularisers: &[Regulariser],
    ) -> Result<(Self, Vec<u32>), FitError> {
        let (targets, loss) = match self.loss.of_targets(&smaller) {
            Some(loss) => (smaller, Arc::from(loss)),
            None => (self.targets.clone(), self.loss.clone()),
        };
        let sizes: Vec<[u32; 2]> = targets.iter().map(|t| [t.camera.width, t.camera.height]).collect();
        let (parameters, of) = self.parameters.without_textures(x, &sizes)?;
        let regularisers = Regularisers::applicable(regularisers, &parameters);
        Ok((Self { parameters, targets, loss, regularisers }, of))
    }
}

/// Targets that are averaged down by whole factors to about [`PIXELS`] together, as far as the sizes of their pictures have such factors.
fn averaged_down(targets: &[Target]) -> Vec<Target> {
    let pixels: usize = targets.iter().map(|target| target.pixels.len()).sum();
    let wanted = (pixels as f64 / PIXELS as f64).sqrt().round().max(1.0) as u32;
    let smaller = |target: &Target| {
        target.averaged((2..=wanted).rev().find(|&factor| suits(target, factor, SIDE)).unwrap_or(1))
    };
    parallel::map(targets, smaller)
}

/// Targets that are averaged down by a factor, or where that does not suit by the next smaller of [`LEVELS`] that does; `None` if it suits none.
fn halved(targets: &[Target], factor: u32) -> Option<Vec<Target>> {
    let levels = || LEVELS.into_iter().filter(|level| *level <= factor);
    let suitable = |target: &Target| levels().find(|&level| suits(target, level, SIDE_OF_LEVEL)).unwrap_or(1);
    let factors: Vec<u32> = targets.iter().map(suitable).collect();
    let smaller = |(target, &factor): (&Target, &u32)| target.averaged(factor);
    factors.contains(&factor).then(|| parallel::map(targets.iter().zip(&factors), smaller))
}

/// Whether a target may be averaged down by a factor to sides of `least` pixels or more.
fn suits(target: &Target, factor: u32, least: u32) -> bool {
    let sides = [target.camera.width, target.camera.height];
    sides.iter().all(|side| side.is_multiple_of(factor) && side / factor >= least)
}
