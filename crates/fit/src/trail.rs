//! What pictures depend on beside their scene, so that a resumed fit can go through it again and take the same steps.

use super::problem::Problem;
use super::renderer::{RenderError, Renderer};
use serde::{Deserialize, Serialize};

/// Points after which light is solved from darkness again, so that a resumed fit has few to go through.
const LONGEST: usize = 10;

/// The points, in units of the unknowns, that have left their mark on a renderer.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Trail {
    /// Rendered since light was last solved from darkness: each solve starts from the light of the point before.
    points: Vec<Vec<f64>>,
    /// The point for which clusters had been chosen before these.
    chosen_before: Option<Vec<f64>>,
    /// The point for which clusters have been chosen by now.
    chosen: Option<Vec<f64>>,
    /// Whether visibility has become explicit.
    explicit: bool,
}

impl Trail {
    /// Brings a renderer into the state in which it left these points.
    ///
    /// # Errors
    /// Fails if a picture cannot be rendered, except for a scene without solution.
    pub fn retrace(&self, problem: &Problem, renderer: &mut dyn Renderer) -> Result<(), RenderError> {
        let unless_without_answer = |done: Result<(), RenderError>| match done {
            Err(RenderError::NoAnswer(_)) => Ok(()),
            other => other,
        };
        renderer.forget();
        let chosen_for = self.chosen_before.as_ref().map(|x| problem.parameters.scene(x));
        unless_without_answer(renderer.choose(chosen_for.as_ref()))?;
        for x in &self.points {
            unless_without_answer(renderer.pictures(&problem.parameters.scene(x)).map(drop))?;
        }
        Ok(())
    }

    /// Whether visibility has become explicit.
    pub fn is_explicit(&self) -> bool {
        self.explicit
    }

    /// Whether it is time to start from darkness again.
    pub fn is_long(&self) -> bool {
        self.points.len() >= LONGEST
    }

    /// Forgets points whose light is no start for that of others.
    pub fn clear(&mut self) {
        self.points.clear();
        self.chosen_before.clone_from(&self.chosen);
    }

    /// Renders a point by `work`, of whose light later pictures are independent unless it `stays`.
    pub fn follow<T>(
        &mut self,
        x: &[f64],
        stays: bool,
        renderer: &mut dyn Renderer,
        work: impl FnOnce(&mut dyn Renderer) -> T,
    ) -> T {
        let choices = renderer.choices();
        let done = work(renderer);
        self.explicit = renderer.has_become_explicit();
        if stays {
            self.points.push(x.to_vec());
        }
        if renderer.choices() > choices {
            self.chosen = Some(x.to_vec());
            if !stays {
                self.chosen_before.clone_from(&self.chosen);
            }
        }
        done
    }
}
