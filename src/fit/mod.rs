//! Fitting scenes to pictures: which lights, materials and positions explain what was seen.
//!
//! A [`Job`] has a scene, [`Target`] pictures with their cameras, a list of what to [`Fit`], a [`PictureLoss`], assumptions
//! ([`Regulariser`]) and an [`optimiser`]. [`Parameters`] leads from a vector of unknowns to a scene and pulls derivatives
//! back; a [`Renderer`] makes pictures and derivatives of scenes; [`Problem`] puts both together. [`JobFile`] reads a job
//! from TOML, [`results`] writes what was found. A [`FolderLock`] keeps other processes out.

mod checkpoint;
mod engine_renderer;
mod gradient;
mod job;
mod job_file;
mod limit;
mod lock;
mod loss;
mod motion;
pub mod optimiser;
mod parameters;
mod problem;
mod regulariser;
mod renderer;
pub mod results;
mod selection;
mod settings;
mod target;

pub use checkpoint::CheckpointError;
pub use engine_renderer::EngineRenderer;
pub use gradient::{Quantity, SceneGradient};
pub use job::{FitError, FitProgress, Job, OnCheckpoint, Outcome, Record, RunOptions, Stop};
pub use job_file::JobFile;
pub use lock::{FolderLock, LockError};
pub use loss::{Loss, LossKind, PictureLoss};
pub use parameters::{Fit, MotionKind, ParameterError, Parameters, Per, Recovered, Unseen};
pub use problem::{Evaluation, Judged, Problem};
pub use regulariser::{Regulariser, Regularisers};
pub use renderer::{CostEstimate, RenderError, Renderer};
pub use settings::{OptimiserKind, Settings, StopRule};
pub use target::{Target, TargetError, TargetPicture, read_mask};
