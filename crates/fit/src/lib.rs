//! Inverse rendering: finds lights, materials and positions that explain pictures.
//!
//! A [`Job`] has a scene, [`Target`] pictures with their cameras, a list of quantities to [`Fit`], a [`PictureLoss`],
//! [`Regulariser`]s and an [`optimiser`]. [`Parameters`] maps a vector of unknowns to a scene and pulls derivatives back; a
//! [`Renderer`] computes pictures of scenes and their derivatives; [`Problem`] combines both. [`JobFile`] reads a job from
//! TOML, [`results`] writes the result. A [`FolderLock`] keeps other processes out, and a [`Status`] tells them how far it is.
#![warn(missing_docs)]

mod checkpoint;
mod coarse;
mod detect;
mod engine_renderer;
mod exposure;
mod first_hits;
mod flow;
mod job;
mod job_file;
mod limit;
mod lock;
mod loss;
mod median;
mod motion;
mod noise;
pub mod optimiser;
mod parameters;
mod photographs;
mod poses;
mod problem;
mod regulariser;
mod renderer;
mod response;
pub mod results;
mod segments;
mod selection;
mod settings;
mod status;
mod target;
mod target_table;
mod trail;
mod usual_fits;

pub use antirad_render::render::{CameraGradient, Quantity, SceneGradient};
pub use checkpoint::{CHECKPOINT_FILES, CheckpointError};
pub use detect::{Candidate, candidates};
pub use engine_renderer::EngineRenderer;
pub use exposure::{Exposure, Sensor};
pub use job::{FitError, FitProgress, Job, OnCheckpoint, Outcome, Record, RunOptions, Stop};
pub use job_file::JobFile;
pub use lock::{FolderLock, LockError};
pub use loss::{Loss, LossKind, PictureLoss};
pub use noise::Noise;
pub use parameters::{Fit, Groups, MotionKind, ParameterError, Parameters, Per, Recovered, Unseen};
pub use photographs::{Photographs, USUAL_PIXELS};
pub use problem::{Evaluation, Judged, Problem};
pub use regulariser::{Regulariser, Regularisers};
pub use renderer::{CostEstimate, OwnSquares, RenderError, Renderer};
pub use response::{Response, ResponseCurve, UnknownResponse};
pub use segments::segments;
pub use settings::{OptimiserKind, Settings, StopRule};
pub use status::{State, Status, now};
pub use target::{Target, TargetError, TargetPicture, read_mask};
