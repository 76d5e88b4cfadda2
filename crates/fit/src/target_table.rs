//! `[[target]]` of job files: a picture with its camera, or a set of photographs.

use super::exposure::Exposure;
use super::job::FitError;
use super::job_file::positive;
use super::noise::Noise;
use super::photographs::{Photographs, USUAL_PIXELS};
use super::response::{Response, UnknownResponse};
use super::selection::unknown;
use super::target::{Target, TargetError, open_mask, radiance, unreadable, weights, wrong_size};
use antirad_render::image::{Photo, PhotoMask};
use antirad_scene::{Camera, CameraSet, CameraTable, Place, Scene, SceneError, Similarity, TomlFile};
use serde::Deserialize;
use std::ops::Range;
use std::path::PathBuf;
use toml::Spanned;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TargetTable {
    picture: Option<Spanned<PathBuf>>,
    camera: Option<Spanned<String>>,
    view: Option<Spanned<CameraTable>>,
    cameras: Option<Spanned<PathBuf>>,
    images: Option<Spanned<PathBuf>>,
    suffix: Option<Spanned<String>>,
    every: Option<Spanned<usize>>,
    frames: Option<Spanned<Vec<String>>>,
    scale: Option<Spanned<f64>>,
    pixels: Option<Spanned<usize>>,
    transform: Option<Spanned<Vec<Vec<f64>>>>,
    layer: Option<String>,
    mask: Option<Spanned<PathBuf>>,
    segments: Option<Spanned<PathBuf>>,
    noise: Option<Spanned<Noise>>,
    weight: Option<f64>,
    white: Option<Spanned<f64>>,
    clipped: Option<Clipped>,
    exposure: Option<Spanned<Unknown>>,
    white_balance: Option<Spanned<Unknown>>,
    response: Option<Spanned<Curve>>,
    gamma: Option<Spanned<f64>>,
}

impl TargetTable {
    /// Where it states a noise.
    pub(super) fn noise_span(&self) -> Option<Range<usize>> {
        self.noise.as_ref().map(Spanned::span)
    }

    /// Whether it is a set of photographs.
    pub(super) fn is_set(&self) -> bool {
        self.cameras.is_some()
    }
}

/// How to treat clipped pixels of integer formats.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Clipped {
    Ignore,
    Use,
    Bound,
}

/// Whether a factor between radiance and the numbers of a picture is known.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
enum Unknown {
    /// It is that of `white`.
    Known,
    /// Each picture has its own.
    Fit,
    /// All pictures of the table have the same.
    FitShared,
}

/// What a response is by.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
enum Curve {
    Srgb,
    Linear,
    Gamma,
    Fit,
}

/// What all pictures of a table have in common.
#[derive(Clone, Copy, Debug)]
pub(super) struct Treatment {
    /// Radiance of white in an integer format.
    pub white: f64,
    /// As stated.
    pub clipped: Option<Clipped>,
    /// Of each view.
    pub weight: f64,
    /// Of a pixel of the file, in units of white.
    pub noise: Option<Noise>,
    /// What of exposures is unknown in pictures that end at white, and in others.
    pub exposures: [Exposure; 2],
    /// Of cameras, as stated; sRGB in pictures that end at white, and linear in others.
    pub response: Option<Response>,
    /// Tells tables apart: their pictures share a response that is to be found.
    pub table: u32,
}

/// Exponent of `response = "gamma"` unless it is stated.
const GAMMA: f64 = 2.2;

/// Above this part of white, values of a channel are lower bounds: JPEG rounds.
const CLIP: f64 = 0.99;

impl Treatment {
    /// That of photographs of which nothing is stated: phones choose exposure and white balance for each.
    pub fn of_photographs() -> Self {
        let exposures = [Exposure::GAIN_AND_WHITE_BALANCE, Exposure::default()];
        Self { white: 1.0, clipped: None, weight: 1.0, noise: None, exposures, response: None, table: 0 }
    }

    /// A photo in linear light, by the response stated.
    pub fn linear(&self, photo: Photo) -> Result<Photo, TargetError> {
        match self.response {
            None | Some(Response::Srgb | Response::Fit) if photo.ends_at_white => Ok(photo),
            None | Some(Response::Linear) if !photo.ends_at_white => Ok(photo),
            Some(response) if photo.ends_at_white => {
                Ok(photo.decoded_again(|decoded| response.light_of(decoded)))
            }
            _ => Err(TargetError::Response),
        }
    }

    /// A target from a linear picture of the camera's size and weights of its pixels, and how many clipped pixels are ignored. `across`:
    /// pixels of the file along the picture.
    pub fn target(
        &self,
        photo: &Photo,
        mask: Option<Vec<f64>>,
        camera: Camera,
        across: u32,
    ) -> Result<(Target, usize), TargetError> {
        let mut mask = mask;
        let mut ignored = 0;
        let exposure = self.exposures[usize::from(!photo.ends_at_white)];
        let usual = if exposure.is_fitted() { Clipped::Bound } else { Clipped::Ignore };
        let clipped = self.clipped.unwrap_or(usual);
        if clipped == Clipped::Ignore && photo.clipped.contains(&true) {
            let mask = mask.get_or_insert_with(|| vec![1.0; photo.pixels.len()]);
            let clipped = mask.iter_mut().zip(&photo.clipped).filter(|(_, clipped)| **clipped);
            for (mask, _) in clipped.filter(|(mask, _)| **mask > 0.0) {
                *mask = 0.0;
                ignored += 1;
            }
        }
        let pixels = radiance(photo, self.white);
        let averaged = (f64::from(across) / f64::from(camera.width)).max(1.0).powi(2);
        let clip = (clipped == Clipped::Bound && photo.ends_at_white).then_some(CLIP * self.white);
        let mut target = Target::new(camera, pixels, mask, self.weight)?.exposed(exposure);
        target.clip = clip;
        target.bounds = clip.and(Some(&photo.clipped)).filter(|clipped| clipped.contains(&true)).cloned();
        target.exposure_guess = photo.exposure;
        let white = if photo.ends_at_white { self.white } else { 1.0 };
        target.noise = self.noise.map(|noise| noise.scaled(white).of_means(averaged));
        let unknown = UnknownResponse { white: self.white, shared: self.table };
        target.response = (self.response == Some(Response::Fit)).then_some(unknown);
        Ok((target, ignored))
    }
}

/// The targets of a table.
pub(super) fn read_targets(
    file: &TomlFile,
    table: &Spanned<TargetTable>,
    scene: &Scene,
    warnings: &mut Vec<String>,
) -> Result<Vec<Target>, FitError> {
    let place = file.place(table.span());
    let table = table.get_ref();
    let white = match &table.white {
        Some(white) => {
            positive("white", Some(*white.get_ref()), file.place(white.span()))?;
            *white.get_ref()
        }
        None => 1.0,
    };
    let exposures = exposures(file, table, place.line)?;
    let (clipped, weight) = (table.clipped, table.weight.unwrap_or(1.0));
    let noise = noise(file, table)?;
    let response = response(file, table)?;
    let treatment =
        Treatment { white, clipped, weight, noise, exposures, response, table: place.line as u32 };
    match (&table.cameras, &table.picture) {
        (Some(cameras), None) => read_set(file, table, cameras, &treatment, warnings),
        (None, Some(picture)) => {
            read_picture(file, table, picture, scene, place, &treatment, warnings).map(|target| vec![target])
        }
        (Some(_), Some(picture)) => Err(file
            .place(picture.span())
            .error("a target has either `picture` or `cameras`, not both; `images` is the folder of a set's pictures")
            .into()),
        (None, None) => Err(place
            .error("which picture? Add `picture = \"FILE\"`, or `cameras = \"transforms.json\"` for a set of photographs")
            .into()),
    }
}

/// The noise stated.
fn noise(file: &TomlFile, table: &TargetTable) -> Result<Option<Noise>, SceneError> {
    let Some(noise) = &table.noise else { return Ok(None) };
    noise.get_ref().check().map_err(|message| file.place(noise.span()).error(message))?;
    Ok(Some(*noise.get_ref()))
}

/// The response stated.
fn response(file: &TomlFile, table: &TargetTable) -> Result<Option<Response>, SceneError> {
    let curve = table.response.as_ref().map(|curve| *curve.get_ref());
    if let Some(gamma) = &table.gamma {
        positive("gamma", Some(*gamma.get_ref()), file.place(gamma.span()))?;
        if curve != Some(Curve::Gamma) {
            return Err(file
                .place(gamma.span())
                .error("`gamma` is for response = \"gamma\"; add that, or remove it"));
        }
    }
    Ok(curve.map(|curve| match curve {
        Curve::Srgb => Response::Srgb,
        Curve::Linear => Response::Linear,
        Curve::Gamma => Response::Gamma(table.gamma.as_ref().map_or(GAMMA, |gamma| *gamma.get_ref())),
        Curve::Fit => Response::Fit,
    }))
}

/// What is unknown of pictures that end at white, and of others: what is stated, and unless anything is, exposure and white balance of
/// photographs of a set, as phones choose them for each. `line`: tells tables apart that share their factors.
fn exposures(file: &TomlFile, table: &TargetTable, line: usize) -> Result<[Exposure; 2], SceneError> {
    let [exposure, white_balance] = [&table.exposure, &table.white_balance].map(|of| of.as_ref());
    if exposure.is_none() && white_balance.is_none() {
        let are_photographs = table.is_set() && table.white.is_none();
        return Ok(if are_photographs { Treatment::of_photographs().exposures } else { Default::default() });
    }
    let is = |of: Option<&Spanned<Unknown>>, what: Unknown| of.is_some_and(|of| *of.get_ref() == what);
    let fitted = |of| is(of, Unknown::Fit) || is(of, Unknown::FitShared);
    let shares = |of| is(of, Unknown::FitShared);
    if fitted(exposure)
        && fitted(white_balance)
        && shares(exposure) != shares(white_balance)
        && let Some(span) = white_balance.map(Spanned::span)
    {
        return Err(file
            .place(span)
            .error("`exposure` and `white_balance` are both \"fit\" or both \"fit-shared\""));
    }
    let shared = (shares(exposure) || shares(white_balance)).then_some(line as u32);
    let found = Exposure { gain: fitted(exposure), white_balance: fitted(white_balance), shared };
    Ok([found; 2])
}

fn read_picture(
    file: &TomlFile,
    table: &TargetTable,
    picture: &Spanned<PathBuf>,
    scene: &Scene,
    place: Place,
    treatment: &Treatment,
    warnings: &mut Vec<String>,
) -> Result<Target, FitError> {
    let of_sets = [
        ("images", table.images.as_ref().map(Spanned::span)),
        ("suffix", table.suffix.as_ref().map(Spanned::span)),
        ("every", table.every.as_ref().map(Spanned::span)),
        ("frames", table.frames.as_ref().map(Spanned::span)),
        ("scale", table.scale.as_ref().map(Spanned::span)),
        ("pixels", table.pixels.as_ref().map(Spanned::span)),
        ("segments", table.segments.as_ref().map(Spanned::span)),
        ("transform", table.transform.as_ref().map(Spanned::span)),
    ];
    if let Some((key, span)) = of_sets.into_iter().find_map(|(key, span)| Some((key, span?))) {
        return Err(file
            .place(span)
            .error(format!("`{key}` is for sets of photographs, with `cameras`; remove it"))
            .into());
    }
    let camera = choose_camera(file, table, picture, scene, place)?;
    let blame = file.place(picture.span());
    let path = file.beside(picture.get_ref());
    let of_picture = |error: TargetError| blame.error(error.of(&path));
    let photo = Photo::read(&path, table.layer.as_deref()).map_err(|error| of_picture(unreadable(error)))?;
    let photo = treatment.linear(photo).map_err(of_picture)?;
    let mask = match &table.mask {
        Some(mask) => {
            let path = file.beside(mask.get_ref());
            let error = |error: TargetError| file.place(mask.span()).error(error.of(&path));
            let mask = open_mask(&path).map_err(error)?;
            if mask.averaged(camera.width, camera.height).is_none() {
                return Err(error(wrong_size("the mask", [mask.width, mask.height], &camera)).into());
            }
            Some(mask)
        }
        None => None,
    };
    let size = [photo.width, photo.height];
    let (photo, mask) = averaged(&photo, mask.as_ref(), &camera)
        .ok_or_else(|| of_picture(wrong_size("the picture", size, &camera)))?;
    let (target, ignored) = treatment.target(&photo, mask, camera, size[0]).map_err(of_picture)?;
    if ignored > 0 {
        warnings.push(format!(
            "{}: {ignored} clipped pixels are ignored, as the true values may be brighter; clipped = \"use\" uses them.",
            path.display()
        ));
    }
    Ok(target)
}

/// A photo and its mask at the camera's size; `None` if that of one of them is no multiple of it.
pub(super) fn averaged(
    photo: &Photo,
    mask: Option<&PhotoMask>,
    camera: &Camera,
) -> Option<(Photo, Option<Vec<f64>>)> {
    let (width, height) = (camera.width, camera.height);
    let alike = mask.filter(|mask| (mask.width, mask.height) == (photo.width, photo.height));
    let (photo, both) = photo.averaged(alike, width, height)?;
    let mask = match (both, mask) {
        (Some(mask), _) => Some(mask),
        (None, Some(mask)) => Some(mask.averaged(width, height)?),
        (None, None) => None,
    };
    Some((photo, mask.as_ref().map(weights)))
}

fn choose_camera(
    file: &TomlFile,
    table: &TargetTable,
    picture: &Spanned<PathBuf>,
    scene: &Scene,
    place: Place,
) -> Result<Camera, SceneError> {
    match (&table.camera, &table.view) {
        (Some(name), None) => {
            let known = scene.cameras.iter().map(|c| c.name.as_str());
            let place = file.place(name.span());
            let name = name.get_ref();
            scene.camera(name).cloned().ok_or_else(|| place.error(unknown("camera", name, known)))
        }
        (None, Some(view)) => {
            let place = file.place(view.span());
            let stem = picture.get_ref().file_stem().unwrap_or_default();
            let camera = view.get_ref().camera(stem.to_string_lossy().into_owned(), place)?;
            camera.check().map_err(|error| place.error(error.to_string()))?;
            Ok(camera)
        }
        (Some(_), Some(_)) => Err(place.error("a target has either `camera` or `view`, not both")),
        (None, None) => match scene.cameras.as_slice() {
            [only] => Ok(only.clone()),
            _ => {
                let names: Vec<_> = scene.cameras.iter().map(|c| c.name.as_str()).collect();
                let names = names.join(", ");
                Err(place.error(format!("which camera took the picture? Add `camera = \"NAME\"`: {names}")))
            }
        },
    }
}

fn read_set(
    file: &TomlFile,
    table: &TargetTable,
    cameras: &Spanned<PathBuf>,
    treatment: &Treatment,
    warnings: &mut Vec<String>,
) -> Result<Vec<Target>, FitError> {
    let place = file.place(cameras.span());
    let of_pictures = [
        ("camera", table.camera.as_ref().map(Spanned::span)),
        ("view", table.view.as_ref().map(Spanned::span)),
    ];
    if let Some((key, span)) = of_pictures.into_iter().find_map(|(key, span)| Some((key, span?))) {
        let message =
            format!("`{key}` is for one picture; `cameras` has a camera for each; remove one of the two");
        return Err(file.place(span).error(message).into());
    }
    let mut set =
        CameraSet::read(&file.beside(cameras.get_ref())).map_err(|error| place.error(error.to_string()))?;
    choose_frames(file, table, &mut set)?;
    if let Some(rows) = &table.transform {
        let to_scene = Similarity::from_rows(rows.get_ref())
            .map_err(|message| file.place(rows.span()).error(format!("transform: {message}")))?;
        set.frames.iter_mut().for_each(|frame| frame.transform(&to_scene));
    }
    let mut photographs = Photographs {
        set,
        images: table.images.as_ref().map(|folder| file.beside(folder.get_ref())),
        suffix: table.suffix.as_ref().map(|suffix| suffix.get_ref().clone()),
        mask: table.mask.as_ref().map(|mask| file.beside(mask.get_ref())),
        segments: table.segments.as_ref().map(|segments| file.beside(segments.get_ref())),
        layer: table.layer.clone(),
        shrink: 1,
        treatment: *treatment,
    };
    photographs.shrink = match (&table.scale, &table.pixels) {
        (Some(scale), None) => {
            shrink(*scale.get_ref()).map_err(|message| file.place(scale.span()).error(message))?
        }
        (Some(_), Some(pixels)) => {
            return Err(file
                .place(pixels.span())
                .error("a target has either `scale` or `pixels`, not both")
                .into());
        }
        (None, Some(pixels)) if *pixels.get_ref() == 0 => {
            return Err(file.place(pixels.span()).error("pixels = 0; it must be 1 or more").into());
        }
        (None, pixels) => {
            let most = pixels.as_ref().map_or(USUAL_PIXELS, |pixels| *pixels.get_ref());
            let shrink = photographs.shrink_to(most);
            if shrink > 1 && pixels.is_none() {
                warnings.push(format!(
                    "{}: {} photos are averaged down by {shrink} along both sides, to at most {} million pixels together; `scale` or \
                     `pixels` states otherwise.",
                    photographs.set.path.display(),
                    photographs.set.frames.len(),
                    USUAL_PIXELS / 1_000_000
                ));
            }
            shrink
        }
    };
    let read = photographs.read().map_err(|message| place.error(message))?;
    let clipped: Vec<usize> =
        read.iter().map(|(_, ignored)| *ignored).filter(|ignored| *ignored > 0).collect();
    if !clipped.is_empty() {
        warnings.push(format!(
            "{}: {} clipped pixels in {} of {} pictures are ignored, as the true values may be brighter; clipped = \"use\" uses them.",
            photographs.set.path.display(),
            clipped.iter().sum::<usize>(),
            clipped.len(),
            read.len()
        ));
    }
    let name = cameras.get_ref().display().to_string();
    Ok(read.into_iter().map(|(target, _)| Target { set: Some(name.clone()), ..target }).collect())
}

fn choose_frames(file: &TomlFile, table: &TargetTable, set: &mut CameraSet) -> Result<(), SceneError> {
    match (&table.frames, &table.every) {
        (Some(_), Some(every)) => {
            Err(file.place(every.span()).error("a target has either `every` or `frames`, not both"))
        }
        (None, Some(every)) if *every.get_ref() == 0 => {
            Err(file.place(every.span()).error("every = 0; it must be 1 or more frames"))
        }
        (None, every) => {
            let every = every.as_ref().map_or(1, |every| *every.get_ref());
            set.frames = std::mem::take(&mut set.frames).into_iter().step_by(every).collect();
            Ok(())
        }
        (Some(names), None) => {
            let place = file.place(names.span());
            if names.get_ref().is_empty() {
                return Err(place.error("`frames` is empty; name at least one, or leave it out for all"));
            }
            let find = |name: &String| {
                let known = set.frames.iter().map(|frame| frame.name.as_str());
                set.frame(name).cloned().ok_or_else(|| place.error(unknown("frame", name, known)))
            };
            set.frames = names.get_ref().iter().map(find).collect::<Result<_, _>>()?;
            Ok(())
        }
    }
}

/// One over a scale.
fn shrink(scale: f64) -> Result<u32, String> {
    let shrink = (1.0 / scale).round();
    match (1.0..=1024.0).contains(&shrink) && (shrink * scale - 1.0).abs() < 1e-3 {
        true => Ok(shrink as u32),
        false => Err(format!("scale = {scale}; it must be 1 over a whole number: 0.5, 0.25, 0.125 …")),
    }
}
#[cfg(test)]
mod tests {
    use crate::{JobFile, Noise};
    use antirad_render::image::Picture;
    use std::path::Path;
    use tempfile::TempDir;

    const SCENE: &str =
        "[[mesh]]\nshape = { kind = \"quad\" }\nmaterial = \"m\"\n[material.m]\n[sky]\nradiance = 1\n";

    /// Two frames of 8 x 6 pixels, as floats and as bytes.
    fn folder() -> TempDir {
        let folder = tempfile::tempdir().expect("a folder");
        let at = folder.path();
        std::fs::write(at.join("s.toml"), SCENE).expect("written");
        for (name, factor) in [("a", 1.0), ("b", 3.0)] {
            let pixels =
                (0..48).map(|k| [factor * (k % 8) as f32, factor * (k / 8) as f32, 1.0, 1.0]).collect();
            let picture = Picture { width: 8, height: 6, pixels };
            picture.write_exr(at.join(format!("{name}.exr"))).expect("written");
            image::RgbImage::from_fn(8, 6, |x, y| image::Rgb([if (x, y) == (7, 5) { 255 } else { 128 }; 3]))
                .save_with_format(at.join(format!("{name}.PNG")), image::ImageFormat::Png)
                .expect("written");
        }
        std::fs::write(at.join("t.json"), transforms("\"fl_x\": 8, \"w\": 8, \"h\": 6")).expect("written");
        folder
    }

    fn transforms(lens: &str) -> String {
        let frame = |name: &str, x: f64| {
            format!(
                "{{\"file_path\": \"{name}\", \"transform_matrix\": [[1, 0, 0, {x}], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]}}"
            )
        };
        format!("{{{lens}, \"frames\": [{}, {}]}}", frame("./a", 0.0), frame("./b", 1.0))
    }

    fn load(folder: &Path, target: &str) -> Result<JobFile, String> {
        let job = format!("scene = \"s.toml\"\n[[fit]]\nparameter = \"albedo\"\n[[target]]\n{target}");
        std::fs::write(folder.join("j.toml"), job).expect("written");
        JobFile::load(&folder.join("j.toml")).map_err(|error| error.to_string())
    }

    fn refused(folder: &Path, target: &str, parts: &[&str]) {
        let error = load(folder, target).err().unwrap_or_else(|| panic!("{target} is taken"));
        for part in parts {
            assert!(error.contains(part), "{error} lacks {part}");
        }
    }

    #[test]
    fn each_frame_is_a_target() {
        let folder = folder();
        let file = load(folder.path(), "cameras = \"t.json\"\nsuffix = \"exr\"\nweight = 2").expect("a job");
        let targets = &file.job.problem().targets;
        let names: Vec<&str> = targets.iter().map(|target| target.camera.name.as_str()).collect();
        assert_eq!(names, ["a", "b"]);
        assert_eq!(targets[1].camera.position.to_array(), [1.0, 0.0, 2.0]);
        assert_eq!(targets[1].camera.target.to_array(), [1.0, 0.0, 1.0]);
        assert!((targets[0].camera.fov_x_degrees - 2.0 * 0.5_f64.atan().to_degrees()).abs() < 1e-9);
        assert_eq!((targets[1].pixels[9].to_array(), targets[1].weight), ([3.0, 3.0, 1.0], 2.0));
        assert!(
            targets[0].mask.is_none() && file.warnings.iter().all(|warning| !warning.contains("clipped"))
        );
        // Without suffix, the PNGs go first, whatever their case.
        let file = load(folder.path(), "cameras = \"t.json\"\nwhite = 5\nframes = [\"b\"]").expect("a job");
        let target = &file.job.problem().targets[0];
        assert!((target.pixels[0].x - 5.0 * 0.215_86).abs() < 1e-3);
        assert_eq!((target.mask_at(0), target.mask_at(47)), (1.0, 0.0));
        assert!(file.warnings.iter().any(|warning| warning.contains("1 clipped pixels in 1 of 1 pictures")));
    }

    #[test]
    fn sets_are_scaled_moved_and_masked() {
        let folder = folder();
        image::GrayImage::from_fn(8, 6, |x, _| image::Luma([if x == 0 { 0 } else { 255 }]))
            .save(folder.path().join("m_b.png"))
            .expect("written");
        let keys = "cameras = \"t.json\"\nsuffix = \".exr\"\nscale = 0.5\nframes = [\"b\"]\nmask = \"m_{name}.png\"\n\
                    transform = [[0, 0, 2, 0], [2, 0, 0, 0], [0, 2, 0, 1]]\nnoise = { shot = 4, read = 0.02 }";
        let file = load(folder.path(), keys).expect("a job");
        let target = &file.job.problem().targets[0];
        assert_eq!((target.camera.width, target.camera.height), (4, 3));
        assert!((target.camera.fov_x_degrees - 2.0 * 0.5_f64.atan().to_degrees()).abs() < 1e-9);
        assert_eq!(target.camera.position.to_array(), [4.0, 2.0, 1.0]);
        assert_eq!((target.camera.target - target.camera.position).to_array(), [-1.0, 0.0, 0.0]);
        assert_eq!(target.camera.up.to_array(), [0.0, 0.0, 1.0]);
        // The left half of the first pixel is masked out.
        assert_eq!(target.pixels[0].to_array(), [3.0, 1.5, 1.0]);
        assert_eq!((target.mask_at(0), target.mask_at(1)), (0.5, 1.0));
        // Of means over four pixels.
        assert_eq!(target.noise, Some(Noise { shot: 1.0, read: 0.01 }));
        let file = load(folder.path(), "cameras = \"t.json\"\nevery = 2").expect("a job");
        assert_eq!(file.job.problem().targets.len(), 1);
    }

    /// A lens that is no centred pinhole: the picture is resampled, and what it does not cover is masked out.
    #[test]
    fn other_lenses_are_resampled() {
        let folder = folder();
        std::fs::write(
            folder.path().join("t.json"),
            transforms("\"fl_x\": 8, \"w\": 8, \"h\": 6, \"cx\": 5"),
        )
        .expect("written");
        let file =
            load(folder.path(), "cameras = \"t.json\"\nsuffix = \".exr\"\nframes = [\"a\"]").expect("a job");
        let target = &file.job.problem().targets[0];
        assert!((target.camera.fov_x_degrees - 2.0 * 0.625_f64.atan().to_degrees()).abs() < 1e-9);
        // The middle of the new picture is at 5, 3 of the old one: between columns 4 and 5, of values 4 and 5.
        let mean = f64::midpoint(target.pixels[3 * 8 + 3].x, target.pixels[3 * 8 + 4].x);
        assert!((mean - 4.5).abs() < 1e-6, "{mean}");
        assert_eq!((target.mask_at(3 * 8 + 7), target.mask_at(3 * 8)), (0.0, 1.0));
    }

    #[test]
    fn pictures_of_a_multiple_are_averaged() {
        let folder = folder();
        let view = |width: u32| {
            format!(
                "picture = \"b.exr\"\nview = {{ position = [0, 0, 2], target = [0, 0, 0], fov_x_degrees = 50, width = {width}, height = 3 }}"
            )
        };
        let file = load(folder.path(), &view(4)).expect("a job");
        assert_eq!(file.job.problem().targets[0].pixels[5].to_array(), [7.5, 7.5, 1.0]);
        refused(folder.path(), &view(5), &["j.toml:5", "b.exr", "8 x 6", "5 x 3", "multiple"]);
    }

    /// Two pictures of 48 pixels each.
    #[test]
    fn sets_are_averaged_down_to_a_number_of_pixels() {
        let folder = folder();
        std::fs::write(folder.path().join("t.json"), transforms("\"fl_x\": 8, \"w\": 8, \"h\": 6"))
            .expect("written");
        for (pixels, sides) in [(96, [8, 6]), (95, [4, 3]), (24, [4, 3])] {
            let set = format!("cameras = \"t.json\"\nsuffix = \".exr\"\npixels = {pixels}");
            let file = load(folder.path(), &set).expect("a job");
            let cameras = file.job.problem().targets.iter().map(|target| &target.camera);
            assert!(
                cameras.map(|camera| [camera.width, camera.height]).all(|size| size == sides),
                "{pixels}"
            );
        }
    }

    #[test]
    fn what_is_wrong_with_a_set() {
        let folder = folder();
        let at = folder.path();
        let set = "cameras = \"t.json\"\n";
        let with = |keys: &str| format!("{set}{keys}");
        refused(at, "weight = 1", &["j.toml:4", "which picture?", "cameras"]);
        refused(at, &with("picture = \"a.exr\""), &["j.toml:6", "either `picture` or `cameras`"]);
        refused(at, &with("camera = \"main\""), &["j.toml:6", "`camera`"]);
        refused(at, "picture = \"a.exr\"\nscale = 0.5", &["j.toml:6", "`scale` is for sets"]);
        refused(at, &with("every = 0"), &["j.toml:6", "every = 0"]);
        refused(at, &with("every = 2\nframes = [\"a\"]"), &["j.toml:6", "not both"]);
        refused(at, &with("frames = [\"c\"]"), &["j.toml:6", "frame", "\"c\""]);
        refused(at, &with("frames = []"), &["j.toml:6", "empty"]);
        refused(at, &with("scale = 0.7"), &["j.toml:6", "1 over a whole number"]);
        refused(at, &with("scale = 0"), &["j.toml:6", "1 over a whole number"]);
        refused(at, &with("pixels = 0"), &["j.toml:6", "pixels = 0"]);
        refused(at, &with("scale = 0.5\npixels = 9"), &["j.toml:7", "not both"]);
        refused(at, "picture = \"a.exr\"\npixels = 9", &["j.toml:6", "`pixels` is for sets"]);
        refused(
            at,
            &with("transform = [[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0]]"),
            &["j.toml:6", "similarity"],
        );
        refused(at, &with("suffix = \".jpg\""), &["j.toml:5", "t.json", "frame \"a\"", "a.jpg"]);
        refused(
            at,
            &with("images = \"elsewhere\""),
            &["j.toml:5", "frame \"a\"", "elsewhere/./a", "`images`"],
        );
        refused(at, &with("mask = \"{name}_m.png\""), &["j.toml:5", "frame \"a\"", "a_m.png"]);
        image::GrayImage::new(4, 3).save(at.join("m.png")).expect("written");
        refused(at, &with("mask = \"m.png\""), &["j.toml:5", "frame \"a\"", "m.png", "4 x 3", "8 x 6"]);
        refused(at, &with("layer = \"x\""), &["j.toml:5", "frame \"a\"", "a.PNG", "layer"]);
        refused(at, &with("suffix = \".exr\"\nlayer = \"x\""), &["frame \"a\"", "a.exr", "no layer \"x\""]);
        refused(at, "cameras = \"none.json\"", &["j.toml:5", "none.json", "cannot be read"]);
        std::fs::write(at.join("b.exr"), "no picture").expect("written");
        refused(at, &with("suffix = \".exr\""), &["j.toml:5", "frame \"b\"", "b.exr", "none of EXR"]);
        std::fs::write(at.join("t.json"), transforms("\"fl_x\": 8, \"w\": 9, \"h\": 9")).expect("written");
        refused(at, set, &["frame \"a\"", "a.PNG", "8 x 6", "9 x 9"]);
        std::fs::write(at.join("t.json"), transforms("\"fl_x\": 8, \"w\": 80, \"h\": 60")).expect("written");
        refused(at, set, &["frame \"a\"", "a.PNG", "8 x 6", "80 x 60", "add scale = 0.1"]);
        // A picture that is small already, for a lens of its original.
        let file = load(at, &with("scale = 0.1")).expect("a job");
        assert_eq!(file.job.problem().targets[0].camera.width, 8);
    }
}
