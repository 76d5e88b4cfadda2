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
}

impl Trail {
    /// Brings a renderer into the state in which it left these points.
    ///
    /// # Errors
    /// Fails if a picture cannot be rendered, except for a scene without solution.
    pub fn retrace(&self, problem: &Problem, renderer: &mut dyn Renderer) -> Result<(), RenderError> {
        renderer.forget();
        for x in &self.points {
            match renderer.pictures(&problem.parameters.scene(x)) {
                Ok(_) | Err(RenderError::NoAnswer(_)) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Whether it is time to start from darkness again.
    pub fn is_long(&self) -> bool {
        self.points.len() >= LONGEST
    }

    /// Forgets points whose light is no start for that of others.
    pub fn clear(&mut self) {
        self.points.clear();
    }

    /// Renders a point by `work`, of whose light later pictures are independent unless it `stays`.
    pub fn follow<T>(
        &mut self,
        x: &[f64],
        stays: bool,
        renderer: &mut dyn Renderer,
        work: impl FnOnce(&mut dyn Renderer) -> T,
    ) -> T {
        let done = work(renderer);
        if stays {
            self.points.push(x.to_vec());
        }
        done
    }
}
