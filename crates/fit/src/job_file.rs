//! Job files: what to fit to which pictures, in TOML.

use super::detect::candidates;
use super::job::{FitError, Job};
use super::loss::LossKind;
use super::optimiser::{AdamOptions, QuasiNewtonOptions};
use super::parameters::{Fit, MotionKind, Per};
use super::regulariser::Regulariser;
use super::settings::{OptimiserKind, Settings, StopRule};
use super::target_table::{TargetTable, read_targets};
use super::usual_fits::{lamps, say_lamps, usual_fits};
use antirad_render::image::MAX_SUPERSAMPLE;
use antirad_render::render::Quantity;
use antirad_render::shading::Shading;
use antirad_scene::{BackendChoice, LoadOptions, Place, Scene, SceneError, TomlFile, Triple};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use toml::Spanned;

/// A job from a file, with the options for running it.
pub struct JobFile {
    /// The validated job.
    pub job: Job,
    /// The scene file.
    #[doc(hidden)]
    pub scene_file: PathBuf,
    /// When the fit ends.
    pub stop: StopRule,
    /// Iterations between two checkpoints.
    pub checkpoint_every: u32,
    /// Warnings for the user, in whole sentences.
    #[doc(hidden)]
    pub warnings: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JobTable {
    scene: Spanned<PathBuf>,
    #[serde(default)]
    target: Vec<Spanned<TargetTable>>,
    #[serde(default)]
    fit: Vec<Spanned<FitTable>>,
    loss: Option<Spanned<LossTable>>,
    #[serde(default, alias = "regularizer")]
    regulariser: Vec<Spanned<RegulariserTable>>,
    #[serde(alias = "optimizer")]
    optimiser: Option<Spanned<OptimiserTable>>,
    stop: Option<Spanned<StopTable>>,
    checkpoint: Option<Spanned<CheckpointTable>>,
    solve: Option<Spanned<SolveTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FitTable {
    parameter: Quantity,
    materials: Option<Vec<String>>,
    meshes: Option<Vec<String>>,
    cameras: Option<Vec<String>>,
    per: Option<Per>,
    resolution: Option<u32>,
    detect: Option<bool>,
    motion: Option<MotionKind>,
    together: Option<bool>,
    lower: Option<Triple>,
    upper: Option<Triple>,
    initial: Option<Triple>,
    max_rotation_degrees: Option<f64>,
    max_scale: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LossTable {
    kind: Option<LossKind>,
    epsilon: Option<f64>,
    threshold: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RegulariserTable {
    kind: RegulariserKind,
    of: Option<Quantity>,
    names: Option<Vec<String>>,
    value: Option<Triple>,
    weight: f64,
}

#[derive(Clone, Copy, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
enum RegulariserKind {
    Smoothness,
    Laplacian,
    Sparsity,
    TotalVariation,
    Prior,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct OptimiserTable {
    kind: Option<OptimiserKind>,
    memory: Option<usize>,
    first_step: Option<f64>,
    gauss_newton: Option<usize>,
    noise: Option<f64>,
    learning_rate: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StopTable {
    iterations: Option<u32>,
    relative_decrease: Option<f64>,
    gradient: Option<f64>,
    loss: Option<f64>,
    seconds: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CheckpointTable {
    every: u32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SolveTable {
    tolerance: Option<f64>,
    supersample: Option<u32>,
    shading: Option<Shading>,
    backend: Option<BackendChoice>,
}

/// Relative residual of solves for photographs: far below their noise.
const TOLERANCE_OF_PHOTOGRAPHS: f64 = 3e-4;

/// Weight of the total variation of textures unless regularisers are stated: where each texel is seen by some pixels, it evens out noise of a
/// tenth and keeps lines that differ by a fifth.
const EVENNESS: f64 = 0.1;

/// Weight of the prior of albedos of photographs unless regularisers are stated, and what they are near: only what pictures leave open follows it,
/// such as the albedo of a lamp, whose own light outshines what it reflects.
const OPEN: f64 = 0.01;
const USUAL_ALBEDO: f64 = 0.5;

/// Relative decrease of the loss below which a fit of photographs ends: most of their loss is noise.
const DECREASE_OF_PHOTOGRAPHS: f64 = 2e-3;

/// What is assumed unless regularisers are stated, but for those of a few names.
fn usual_regularisers(fits: &[Fit], are_photographs: bool) -> Vec<Regulariser> {
    let evenness = Regulariser::TotalVariation { weight: EVENNESS };
    let value = Some([USUAL_ALBEDO; 3]);
    let prior = Regulariser::Prior { of: Quantity::Albedo, names: None, value, weight: OPEN };
    let textures = fits.iter().any(|fit| fit.per == Per::Texel);
    let albedos = are_photographs && fits.iter().any(|fit| fit.quantity == Quantity::Albedo);
    [textures.then_some(evenness), albedos.then_some(prior)].into_iter().flatten().collect()
}

impl JobFile {
    /// Reads and checks a job, its scene and its pictures. Paths are relative to the file.
    ///
    /// Everything but `scene`, one `[[target]]` and one `[[fit]]` is optional:
    /// ```toml
    /// scene = "room.toml"
    ///
    /// [[target]]                     # one per view
    /// picture = "photo.exr"          # or a PNG, JPEG, TIFF or HDR; integers are decoded, see response
    /// camera = "main"                # of the scene; or view = { position = [...], ... } as in a scene file
    /// mask = "mask.png"              # white counts, black does not
    /// weight = 1
    /// white = 1                      # radiance of white in integer formats, W/(m² sr)
    /// exposure = "known"             # or "fit", "fit-shared": a factor of each picture, or of all of this table
    /// white_balance = "known"        # the same of red and blue; photos of sets without `white` fit both unless either is stated
    /// response = "srgb"              # of integer formats; or "linear", "gamma" (with gamma = 2.2), "fit": one curve for this table
    /// clipped = "ignore"             # pixels at the end of an integer format; or "use", "bound" (where exposures are fitted)
    /// noise = { shot = 1e-4, read = 3e-3 } # of a channel v, of white: a variance of shot v + read²
    /// layer = "ViewLayer.Combined"   # of an EXR with several
    ///
    /// [[target]]                     # one for each frame of a set of photographs
    /// cameras = "transforms.json"    # or the folder of COLMAP's model
    /// images = "photos"              # default: beside the JSON file; COLMAP's folder `images`
    /// suffix = ".exr"                # in place of that in the set
    /// every = 2                      # each second frame; or frames = ["r_0", "r_7"]
    /// mask = "masks/{name}.png"
    /// segments = "seg/{name}.png"    # one colour for each material, for per = "segment"
    /// scale = 0.5                    # 1 over a whole number
    /// transform = [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]] # from the set's world to the scene's
    ///
    /// [[fit]]
    /// parameter = "albedo"           # or "emission", "diffuse", "specular", "power", "position", "camera"
    /// materials = ["red", "green"]   # default: all
    /// meshes = ["walls"]             # default: all; if both are given, triangles with both
    /// per = "material"               # or "mesh", "segment", "triangle", "texel": a texture for each mesh
    /// # resolution = 64              # of textures, columns and rows
    /// initial = 0.5                  # one number or RGB, as lower and upper; default: the scene's
    /// lower = 0
    /// upper = 0.95
    ///
    /// [[fit]]
    /// parameter = "emission"
    /// detect = true                  # of what pictures show bright, and of what none shows
    ///
    /// [[fit]]
    /// parameter = "position"
    /// meshes = ["box"]
    /// motion = "rigid"               # or "translation", "scale", "similarity", "vertices"
    /// together = false               # all meshes as one body
    /// lower = [-1, 0, -1]            # of the displacement, metres
    /// upper = [1, 0, 1]
    /// max_rotation_degrees = 30
    /// max_scale = 2
    ///
    /// [[fit]]
    /// parameter = "camera"           # where targets were taken from: position and rotation
    /// cameras = ["main"]             # default: those of all targets
    /// lower = [-0.1, -0.1, -0.1]     # of the displacement, metres
    /// upper = [0.1, 0.1, 0.1]
    /// max_rotation_degrees = 5
    /// # together = true              # those of each set as one body, by a similarity: or motion = "rigid", "translation", "scale"
    ///
    /// [loss]
    /// kind = "l2"                    # or "l1", "relative-l2", "log-l1", "huber"; the last is the default for sets
    /// epsilon = 0.01                 # for the last three, W/(m² sr)
    /// # threshold = 0.3              # for "huber": relative difference from which on pixels are outliers
    ///
    /// [[regulariser]]
    /// kind = "smoothness"            # or "prior" (with value and names), "sparsity", "laplacian", "total-variation"
    /// of = "albedo"
    /// weight = 1e-3
    ///
    /// [optimiser]
    /// kind = "auto"                  # or "quasi-newton", "adam", "least-squares"
    /// memory = 10                    # of quasi-newton, like first_step and noise
    /// learning_rate = 0.02           # of adam
    ///
    /// [stop]
    /// iterations = 200
    /// relative_decrease = 1e-4       # over five iterations, with adam fifty
    /// gradient = 1e-7                # relative to the start
    /// loss = 0
    /// seconds = 3600
    ///
    /// [checkpoint]
    /// every = 5                      # iterations
    ///
    /// [solve]
    /// tolerance = 1e-5
    /// supersample = 8
    /// shading = "gathered"           # or "face": one colour per face
    /// backend = "auto"               # or "cpu", "vulkan"; otherwise that of the scene
    /// ```
    ///
    /// # Errors
    /// Fails if the file, its scene or a picture cannot be read, or if a value in them is invalid. The error
    /// says where.
    pub fn load(path: &Path) -> Result<Self, FitError> {
        let file = TomlFile::read(path)?;
        let table: JobTable = file.parse()?;
        let place = file.place(table.scene.span());
        let scene_file = file.beside(table.scene.get_ref());
        let mut scene = Scene::load(&scene_file, &LoadOptions::default()).map_err(|error| match error {
            SceneError::Read { path, reason } => {
                place.error(format!("scene {} cannot be read: {reason}", path.display()))
            }
            other => other,
        })?;
        let mut warnings = scene.warnings.clone();
        // Targets have cameras, and emission may be what is to be found.
        let of_emission = |fit: &Spanned<FitTable>| fit.get_ref().parameter == Quantity::Emission;
        let finds_light = table.fit.is_empty() || table.fit.iter().any(of_emission);
        warnings.retain(|warning| {
            !(warning.starts_with("No camera is given")
                || finds_light && warning.starts_with("No material in use"))
        });

        let whole = Place { path, line: 1 };
        if table.target.is_empty() {
            return Err(whole.error("no [[target]]; give at least one picture to fit to").into());
        }
        let are_photographs = table.target.iter().any(|target| target.get_ref().is_set());
        if table.fit.is_empty() && !are_photographs {
            return Err(whole
                .error("no [[fit]]; say what to fit, for example parameter = \"albedo\"")
                .into());
        }
        let mut targets = Vec::new();
        for target in &table.target {
            targets.extend(read_targets(&file, target, &scene, &mut warnings)?);
        }
        let place_of = |spanned: std::ops::Range<usize>| file.place(spanned);
        let mut fits = table
            .fit
            .iter()
            .map(|fit| fit.get_ref().fit().map_err(|message| place_of(fit.span()).error(message)))
            .collect::<Result<Vec<_>, SceneError>>()?;
        let mut scale_emission = false;
        for (fit, table) in
            fits.iter_mut().zip(&table.fit).filter(|(_, table)| table.get_ref().detect == Some(true))
        {
            let found = candidates(&scene, &targets);
            if found.is_empty() {
                let message = "detect: nothing in the pictures is bright enough to be a lamp; name `meshes` or `materials`";
                return Err(place_of(table.span()).error(message).into());
            }
            warnings.push(say_lamps(&found));
            let lamps = lamps(found);
            scale_emission |= fit.initial.is_none();
            (fit.groups, fit.initial) = (lamps.groups, fit.initial.or(lamps.initial));
        }
        if fits.is_empty() {
            let (usual, assumed) = usual_fits(&scene, &targets).map_err(|message| whole.error(message))?;
            scale_emission = usual.iter().any(|fit| fit.initial.is_some());
            fits = usual;
            warnings.extend(assumed);
        }
        let mut settings = Settings::new(fits).scale_emission(scale_emission);
        if are_photographs {
            settings.loss = LossKind::Huber;
            settings.tolerance = Some(TOLERANCE_OF_PHOTOGRAPHS);
        }
        if let Some(loss) = &table.loss {
            let LossTable { kind, epsilon, threshold } = loss.get_ref();
            settings.loss = kind.unwrap_or(settings.loss);
            settings.epsilon = *epsilon;
            settings.threshold = *threshold;
            positive("epsilon", *epsilon, place_of(loss.span()))?;
            positive("threshold", *threshold, place_of(loss.span()))?;
            if threshold.is_some() && settings.loss != LossKind::Huber {
                return Err(place_of(loss.span())
                    .error("`threshold` is for kind = \"huber\"; remove it")
                    .into());
            }
        }
        let noises = table.target.iter().filter_map(|target| target.get_ref().noise_span());
        if let (LossKind::L1 | LossKind::L2 | LossKind::LogL1, Some(span)) =
            (settings.loss, noises.into_iter().next())
        {
            let message = "`noise` weights the losses huber and relative-l2; state one as `kind` of [loss], or remove it";
            return Err(place_of(span).error(message).into());
        }
        for term in &table.regulariser {
            let regulariser =
                term.get_ref().regulariser().map_err(|message| place_of(term.span()).error(message))?;
            settings.regularisers.push(regulariser);
        }
        if table.regulariser.iter().all(|term| term.get_ref().names.is_some()) {
            settings.regularisers.extend(usual_regularisers(&settings.fits, are_photographs));
        }
        if let Some(optimiser) = &table.optimiser {
            optimiser.get_ref().apply(&mut settings, place_of(optimiser.span()))?;
        }
        if let Some(solve) = &table.solve {
            solve.get_ref().apply(&mut settings, place_of(solve.span()))?;
            scene.settings.backend = solve.get_ref().backend.unwrap_or(scene.settings.backend);
        }
        let mut stop = StopRule::default();
        if are_photographs {
            stop.relative_decrease = DECREASE_OF_PHOTOGRAPHS;
        }
        if let Some(table) = &table.stop {
            table.get_ref().apply(&mut stop, place_of(table.span()))?;
        }
        let checkpoint_every = match &table.checkpoint {
            Some(every) if every.get_ref().every == 0 => {
                return Err(place_of(every.span())
                    .error("every = 0; it must be 1 or more iterations")
                    .into());
            }
            Some(every) => every.get_ref().every,
            None => 5,
        };

        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let job = Job::new(name, scene, targets, settings).map_err(|error| match error {
            FitError::Parameter(error) => {
                let place = table.fit.get(error.fit).map_or(whole, |fit| place_of(fit.span()));
                place.error(error.message).into()
            }
            FitError::Regulariser { index, message } => {
                let place = table.regulariser.get(index).map_or(whole, |term| place_of(term.span()));
                place.error(message).into()
            }
            // Any remaining error is about the optimiser.
            FitError::Settings(message) => {
                let place = table.optimiser.as_ref().map_or(whole, |optimiser| place_of(optimiser.span()));
                place.error(message).into()
            }
            other => other,
        })?;
        Ok(Self { job, scene_file, stop, checkpoint_every, warnings })
    }
}

impl FitTable {
    fn fit(&self) -> Result<Fit, String> {
        let position = self.parameter == Quantity::Position;
        let camera = self.parameter == Quantity::Camera;
        let together = camera && self.together == Some(true);
        let of_positions = [
            ("motion", self.motion.is_some(), together),
            ("together", self.together.is_some(), camera),
            ("max_rotation_degrees", self.max_rotation_degrees.is_some(), camera),
            ("max_scale", self.max_scale.is_some(), together),
        ];
        if let Some((key, ..)) = of_positions.iter().find(|(_, given, suits)| *given && !position && !suits) {
            return Err(match camera {
                true => format!(
                    "`{key}` is for parameter = \"position\", or cameras with together = true; remove it"
                ),
                false => format!("`{key}` is for parameter = \"position\"; remove it"),
            });
        }
        if self.cameras.is_some() && !camera {
            return Err(String::from("`cameras` is for parameter = \"camera\"; remove it"));
        }
        if self.detect == Some(true) && self.parameter != Quantity::Emission {
            return Err(String::from("`detect` is for parameter = \"emission\"; remove it"));
        }
        if self.detect == Some(true) && self.per.is_some() {
            return Err(String::from(
                "`per` and `detect` exclude each other: each candidate has a value; remove one",
            ));
        }
        if self.resolution.is_some() && self.per != Some(Per::Texel) {
            return Err(String::from("`resolution` is for per = \"texel\"; remove it"));
        }
        if camera && self.per.is_some() {
            return Err(String::from("`per` is for materials; each camera moves by itself: remove it"));
        }
        if position && self.per.is_some() {
            return Err(String::from("`per` is for materials; use `motion` for positions"));
        }
        if position && self.motion.is_none() {
            return Err(String::from(
                "how may positions change? Add motion = \"rigid\", \"translation\", \"scale\", \"similarity\" or \
                 \"vertices\"",
            ));
        }
        let triple = |of: &Option<Triple>| of.as_ref().map(|t| t.0);
        let usual = Fit::new(self.parameter);
        Ok(Fit {
            materials: self.materials.clone(),
            meshes: self.meshes.clone(),
            cameras: self.cameras.clone(),
            per: self.per.unwrap_or(usual.per),
            resolution: self.resolution,
            motion: self.motion.unwrap_or(if together { MotionKind::Similarity } else { usual.motion }),
            together: self.together.unwrap_or(false),
            lower: triple(&self.lower),
            upper: triple(&self.upper),
            initial: triple(&self.initial),
            max_rotation_degrees: self.max_rotation_degrees,
            max_scale: self.max_scale,
            ..usual
        })
    }
}

impl RegulariserTable {
    fn regulariser(&self) -> Result<Regulariser, String> {
        let weight = self.weight;
        let value = self.value.as_ref().map(|t| t.0);
        if value.is_some() && self.kind != RegulariserKind::Prior {
            return Err(String::from("`value` is for kind = \"prior\"; remove it"));
        }
        if self.names.is_some() && self.kind != RegulariserKind::Prior {
            return Err(String::from("`names` is for kind = \"prior\"; remove it"));
        }
        match (self.kind, self.of) {
            (RegulariserKind::Smoothness, Some(of)) => Ok(Regulariser::Smoothness { of, weight }),
            (RegulariserKind::Prior, Some(of)) => {
                Ok(Regulariser::Prior { of, names: self.names.clone(), value, weight })
            }
            (RegulariserKind::Smoothness | RegulariserKind::Prior, None) => {
                Err(String::from("which parameter? Add `of`, for example of = \"albedo\""))
            }
            (RegulariserKind::Laplacian, None | Some(Quantity::Position)) => {
                Ok(Regulariser::Laplacian { weight })
            }
            (RegulariserKind::Laplacian, Some(_)) => {
                Err(String::from("`of` must be \"position\" for kind = \"laplacian\"; remove it"))
            }
            (RegulariserKind::TotalVariation, None | Some(Quantity::Albedo)) => {
                Ok(Regulariser::TotalVariation { weight })
            }
            (RegulariserKind::TotalVariation, Some(_)) => {
                Err(String::from("`of` must be \"albedo\" for kind = \"total-variation\"; remove it"))
            }
            (RegulariserKind::Sparsity, None | Some(Quantity::Emission)) => {
                Ok(Regulariser::Sparsity { weight })
            }
            (RegulariserKind::Sparsity, Some(_)) => {
                Err(String::from("`of` must be \"emission\" for kind = \"sparsity\"; remove it"))
            }
        }
    }
}

impl OptimiserTable {
    fn apply(&self, settings: &mut Settings, place: Place) -> Result<(), SceneError> {
        for (what, number) in
            [("first_step", self.first_step), ("noise", self.noise), ("learning_rate", self.learning_rate)]
        {
            positive(what, number, place)?;
        }
        if self.memory == Some(0) {
            return Err(place.error("memory = 0; it must be 1 or more steps"));
        }
        let (newton, adam) = (QuasiNewtonOptions::default(), AdamOptions::default());
        settings.optimiser = self.kind.unwrap_or_default();
        settings.quasi_newton = QuasiNewtonOptions {
            memory: self.memory.unwrap_or(newton.memory),
            first_step: self.first_step.unwrap_or(newton.first_step),
            ..newton
        };
        settings.gauss_newton = self.gauss_newton.unwrap_or(settings.gauss_newton);
        settings.noise = self.noise;
        settings.adam =
            AdamOptions { learning_rate: self.learning_rate.unwrap_or(adam.learning_rate), ..adam };
        Ok(())
    }
}

impl StopTable {
    fn apply(&self, rule: &mut StopRule, place: Place) -> Result<(), SceneError> {
        for (what, number, to) in [
            ("relative_decrease", self.relative_decrease, &mut rule.relative_decrease),
            ("gradient", self.gradient, &mut rule.gradient),
            ("loss", self.loss, &mut rule.loss),
            ("seconds", self.seconds, &mut rule.seconds),
        ] {
            match number {
                Some(number) if number >= 0.0 => *to = number,
                Some(number) => return Err(place.error(format!("{what} = {number}; it must be 0 or more"))),
                None => {}
            }
        }
        if self.iterations == Some(0) {
            return Err(place.error("iterations = 0; it must be 1 or more"));
        }
        rule.iterations = self.iterations.unwrap_or(rule.iterations);
        Ok(())
    }
}

impl SolveTable {
    fn apply(&self, settings: &mut Settings, place: Place) -> Result<(), SceneError> {
        if let Some(tolerance) = self.tolerance {
            if !(1e-9..1.0).contains(&tolerance) {
                return Err(place.error(format!("tolerance = {tolerance}; it must lie between 1e-9 and 1")));
            }
            settings.tolerance = Some(tolerance);
        }
        if let Some(supersample) = self.supersample {
            if !supersample.is_power_of_two() || supersample > MAX_SUPERSAMPLE {
                return Err(place.error(format!(
                    "supersample = {supersample}; it must be a power of two, at most {MAX_SUPERSAMPLE}"
                )));
            }
            settings.supersample = supersample;
        }
        if let Some(shading) = self.shading {
            settings.shading = shading;
        }
        Ok(())
    }
}

pub(super) fn positive(what: &str, number: Option<f64>, place: Place) -> Result<(), SceneError> {
    match number {
        Some(number) if !(number > 0.0 && number.is_finite()) => {
            Err(place.error(format!("{what} = {number}; it must be above 0, and finite")))
        }
        _ => Ok(()),
    }
}
