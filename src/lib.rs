//! Differentiable radiosity: global illumination of triangle scenes, with shadows, on a Vulkan device or on the CPU; and the exact gradients of
//! losses with respect to lights, materials, geometry and cameras ([`Engine::backward`], [`render::Renderer::pull_back`]).
//!
//! The outgoing light is C = (1 - (K - J) U)⁻¹ E. E is the emission, U transports light between triangles, K reflects it. By default U is a sparse
//! matrix of what rays from each triangle meet, and J is zero. With implicit visibility U transports light between all pairs of triangles, ignoring
//! occlusion, and J makes light that a triangle blocks leave its back as negative light, *antiradiance*, which cancels what should not have
//! passed (Dachsbacher et al., ACM TOG 26(3), 2007): its derivatives by positions are those of a smooth function. The solvers find the incident light
//! H = U C.
//!
//! ```no_run
//! use antirad::image::ToneMap;
//! use antirad::scene::{LoadOptions, Scene};
//! use std::path::Path;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scene = Scene::load(Path::new("scenes/cornell_boxes.toml"), &LoadOptions::default())?;
//! let rendered = antirad::render(&scene)?;
//! println!("irradiance of triangle 0: {:?} W/m²", rendered.irradiance[0]);
//! rendered.pictures[0].write_png("room.png", &ToneMap::default())?;
//! # Ok(())
//! # }
//! ```
//!
//! Modules, in the order in which data passes through them: [`scene`] (validated input), [`mod@resolve`] (what it leaves open), [`plan`] (sizes and lists,
//! decided without a device), [`backend`] (where light is computed), [`Engine`] (solves and gradients), [`mod@render`]
//! (pictures), [`mod@fit`] (scenes from pictures). [`path_tracer`] is the truth where there is none in closed form. What
//! they are made of (operators, solvers, kernels, the f64 twin) is in the crates `antirad-*`, whose names may change.
//! Units are SI; light is RGB.
//!
//! Threads: inputs and results can be shared, and so can a [`backend::Backend`], on which several engines can work at
//! once. An [`Engine`] belongs to one thread at a time.
#![warn(missing_docs)]

#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod cli;

#[doc(inline)]
pub use antirad_base::Watch;
#[doc(inline)]
pub use antirad_core::{
    Cotangent, Energy, Engine, EngineBuilder, EngineError, Gradients, MaterialGradients, Negative, RayError,
    Solution, SolveParams,
};
#[doc(inline)]
pub use antirad_render::render::render;
/// The crate of the vector types in this API, in the version it uses.
pub use glam;

/// Scenes: triangle meshes, Blinn-Phong materials, pinhole cameras and the settings of a solve.
///
/// Everything from outside is validated here, once ([`Scene::load`](scene::Scene::load), [`Scene::check`](scene::Scene::check)).
pub mod scene {
    #[doc(inline)]
    pub use antirad_scene::{
        BinLayout, Camera, CameraSet, Frame, Lamps, LoadOptions, Material, Mesh, Movable, Normalization,
        Orient, Painting, Precision, Scene, SceneBuilder, SceneError, Shape, Sky, SolveSettings,
        SolverChoice, Sun, Triangle, VisibilityChoice,
    };
    // For the tool and the Python package.
    #[doc(hidden)]
    pub use antirad_scene::{
        Distortion, Focal, Intrinsics, LampFactor, Lens, Origin, Patterns, Projection, Similarity,
        TextureRefined,
    };
}

/// Where light is computed: on a Vulkan device, or on the CPU.
pub mod backend {
    #[doc(inline)]
    pub use antirad_core::backend::{Backend, BackendChoice, BackendKind, Cpu, CpuOptions};
}

/// Vulkan devices: their list, their options, and those that another program brings ([`embed`](gpu::embed)).
pub mod gpu {
    #[doc(inline)]
    pub use antirad_gpu::{
        Bytes, Device, DeviceInfo, DeviceKind, DeviceOptions, Enabled, GpuError, LabelReport, ListedDevice,
        MemoryReport, OverBudget, ProfileRow, list_devices,
    };
    // For the tool and the Python package.
    #[doc(hidden)]
    pub use antirad_gpu::{KernelStatistics, ValidationLog, staging_bytes};

    /// Vulkan devices of an embedding program.
    pub mod embed {
        #[doc(inline)]
        pub use antirad_gpu::embed::RawDevice;
        /// The version of `ash` whose types [`RawDevice`] takes.
        #[doc(no_inline)]
        pub use antirad_gpu::embed::ash;
    }
}

/// What a scene leaves open, decided once for all that is done with it.
pub mod resolve {
    #[doc(inline)]
    pub use antirad_core::resolve::{Decision, Moves, ResolveOptions, Resolved, resolve};
    #[doc(inline)]
    pub use antirad_scene::Cut;
}

/// Sizes and lists, decided before anything is allocated.
pub mod plan {
    #[doc(inline)]
    pub use antirad_core::plan::{
        GradientRequest, MemoryItem, MemoryPlan, Occlusion, Plan, PlanError, PlanOptions, PlanReport,
    };
}

/// How a solve went.
pub mod solve {
    #[doc(inline)]
    pub use antirad_core::solve::{SolveError, SolveInfo, SolveProgress};
    #[doc(inline)]
    pub use antirad_core::transport::TransportError;
}

/// Pictures of a solved scene, and the derivatives of a loss of pictures by everything that they show.
pub mod render {
    #[doc(inline)]
    pub use antirad_render::image::Coverage;
    #[doc(inline)]
    pub use antirad_render::render::{
        CameraGradient, PictureError, PullBack, Quantity, RenderOptions, Rendered, Renderer, SceneGradient,
        SeenPixels, Shown,
    };
    #[doc(inline)]
    pub use antirad_render::shading::{Gathered, Light, Reflections, Shading};
}

/// Pictures from one colour per face, and their files.
///
/// ```no_run
/// use antirad::backend::Backend;
/// use antirad::image::{PictureOptions, Rasterizer, ToneMap};
/// # fn picture(scene: &antirad::scene::Scene) -> Result<(), antirad::image::ImageError> {
/// let colours = vec![[1.0, 0.5, 0.25]; scene.triangles.len()];
/// let options = PictureOptions::default().supersample(8);
/// let picture = Rasterizer::new(Backend::cpu())?.render(scene, &scene.cameras[0], &colours, &options)?;
/// picture.write_png("scene.png", &ToneMap::default())?;
/// # Ok(())
/// # }
/// ```
pub mod image {
    #[doc(inline)]
    pub use antirad_render::image::{
        Exposure, ImageError, MAX_SUPERSAMPLE, Picture, PictureOptions, Rasterizer, ToneMap,
    };
    // For the tool and the Python package.
    #[doc(hidden)]
    pub use antirad_render::image::{Label, Photo, PhotoLabels, PhotoMask};
}

/// Scenes from pictures: what lights, materials and geometry explain them.
pub mod fit {
    #[doc(inline)]
    pub use antirad_fit::{
        CheckpointError, EngineRenderer, Exposure, Fit, FitError, FitProgress, Groups, Job, JobFile,
        LockError, Loss, LossKind, MotionKind, Noise, OnCheckpoint, OptimiserKind, Outcome, ParameterError,
        Per, Photographs, PictureLoss, Record, Recovered, Regulariser, RenderError, Renderer, Response,
        RunOptions, Settings, Stop, StopRule, Target, TargetError, TargetPicture,
    };
    // For the tool and the Python package.
    #[doc(hidden)]
    pub use antirad_fit::{
        CHECKPOINT_FILES, CostEstimate, Evaluation, FolderLock, Judged, OwnSquares, Parameters, Problem,
        Regularisers, ResponseCurve, Sensor, State, Status, USUAL_PIXELS, UnknownResponse, Unseen, now,
        results, segments,
    };
}

/// Settings and meshes that keep an error which is asked for.
pub mod target_error {
    #[doc(inline)]
    pub use antirad_render::target_error::{
        Answer, ErrorEstimate, IrradianceEstimate, PictureEstimate, Refinement, SearchError, Solved, Stage,
        Step, TargetErrorOptions, solve_within,
    };
}

/// What a scene will do to the accuracy of its solution, found before a solve, and its remedies.
pub mod warnings {
    #[doc(inline)]
    pub use antirad_render::warnings::{
        Effect, Example, Kind, RefineError, RefineOptions, Refined, Warning, Warnings, refine,
    };
    // For the tool and the Python package.
    #[doc(hidden)]
    pub use antirad_render::warnings::{MATTERS, told_from};
}

/// What pictures of a scene leave undetermined.
pub mod ambiguity {
    #[doc(inline)]
    pub use antirad_render::ambiguity::{
        AmbiguityError, DirectLight, FirstBounce, Given, Interval, LightMatrix, Method, Polytope,
        PolytopeError, Views,
    };
}

/// Monte Carlo with visibility tests: the ground truth where there is none in closed form.
///
/// ```
/// use antirad::path_tracer::PathTracer;
/// use antirad::scene::{Camera, Material, SceneBuilder, Shape};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let lamp = Material { emission: [1.0; 3], ..Material::named("lamp") };
/// let mut builder = SceneBuilder::new();
/// builder.shape("lamp", Shape::Box { cells: 1 }, &lamp, glam::DAffine3::IDENTITY);
/// let scene = builder.finish("lamp")?;
/// let traced = PathTracer::new(&scene).picture(&Camera::framing(&scene.vertices), 16, 0);
/// println!("noise {:.1} %", 100.0 * traced.noise());
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("lamp.exr");
/// traced.picture().write_exr(path)?;
/// # Ok(())
/// # }
/// ```
pub mod path_tracer {
    #[doc(inline)]
    pub use antirad_render::path_tracer::{MonteCarloEstimate, PathTracer, TracedPicture, TracedPixel};
}

/// Scenes for other programs: glTF, Mitsuba 3, PLY.
pub mod export {
    #[doc(inline)]
    pub use antirad_render::export::{Format, export};
}

/// Files that appear whole or not at all.
pub mod output {
    #[doc(inline)]
    pub use antirad_base::output::OutputError;
    // For the tool and the Python package.
    #[doc(hidden)]
    pub use antirad_base::output::{
        FileNames, atomic_write, prepare_directory, remove_unfinished, single, write_array, write_json,
        write_new_json, write_npy,
    };
}

/// Several processes on one scene.
pub mod ranks {
    #[cfg(feature = "mpi")]
    #[doc(inline)]
    pub use antirad_base::ranks::World;
    #[doc(inline)]
    pub use antirad_base::ranks::{Communicator, RankError, Ranks, in_threads};
}

/// Which types of the API threads may share or send: a change that breaks this does not compile.
const _: () = {
    const fn moved<T: Send>() {}
    const fn shared<T: Send + Sync>() {}
    shared::<scene::Scene>();
    shared::<scene::SceneError>();
    shared::<plan::PlanOptions>();
    shared::<plan::Plan>();
    shared::<gpu::Device>();
    shared::<gpu::GpuError>();
    shared::<gpu::ValidationLog>();
    shared::<Solution>();
    shared::<EngineError>();
    shared::<Cotangent>();
    shared::<Gradients>();
    shared::<image::Rasterizer>();
    shared::<image::Picture>();
    shared::<image::ImageError>();
    // A pass callback may be bound to one thread at a time; a recording batch always is.
    moved::<Engine>();
    shared::<backend::Backend>();
    moved::<Box<dyn antirad_core::transport::Operators>>();
    moved::<antirad_gpu::Batch>();
    shared::<antirad_gpu::Buffer>();
    shared::<antirad_gpu::Pipeline>();
};

/// The snippets of README.md compile as they stand.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
