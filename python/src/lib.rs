//! The extension module behind the Python package `antirad`: classes and functions of the library, with NumPy arrays in and
//! out. Work runs without the GIL ([`work`]); errors become exceptions with the same words ([`errors`]).

mod ambiguity;
mod arrays;
mod backend;
mod check;
mod engine;
mod errors;
mod fit;
mod picture;
mod plan;
mod renderer;
mod resolved;
mod scene;
mod textures;
mod work;

use pyo3::prelude::*;

/// Compiled part of `antirad`, which re-exports all of it.
#[pymodule]
mod _antirad {
    #[pymodule_export]
    use crate::ambiguity::{Ambiguity, ambiguity};
    #[pymodule_export]
    use crate::backend::{Backend, devices};
    #[pymodule_export]
    use crate::check::{Refined, Warning, check, refine};
    #[pymodule_export]
    use crate::engine::{Engine, Gradients, Solution};
    #[pymodule_export]
    use crate::errors::exceptions::{
        DeviceError, Error, FitError, PictureError, PlanError, SceneError, SolveError,
    };
    #[pymodule_export]
    use crate::fit::{
        Fit, FitResult, Regulariser, Target, fit_, fit_job, load_cameras, load_targets, read_picture,
    };
    #[pymodule_export]
    use crate::picture::write_picture;
    #[pymodule_export]
    use crate::plan::{Plan, plan_};
    #[pymodule_export]
    use crate::renderer::Renderer;
    #[pymodule_export]
    use crate::resolved::Resolved;
    #[pymodule_export]
    use crate::scene::{Camera, Material, Scene};
    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "its name in Python")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
