//! Pictures of a solved scene, and the derivatives of a loss of pictures by everything that they show: one way from cameras to pixels and
//! back for all who want either.

mod gradient;
mod scene;

pub use crate::image::CameraGradient;
pub use crate::shading::ShadingError as PictureError;
pub use gradient::{Quantity, SceneGradient};
pub use scene::{Rendered, render};

use crate::image::{Coverage, ImageError, Picture, Rasterizer, geometry_gradient, geometry_gradient_of};
use crate::shading::{self, Gathered, Light, Reflections, SeenFrom, Shading, TexelGradient};
use antirad_base::ranks::Ranks;
use antirad_base::setters;
use antirad_core::backend::Backend;
use antirad_core::plan::GradientRequest;
use antirad_core::solve::SolveProgress;
use antirad_core::{Cotangent, Engine, EngineError, Solution, SolveParams};
use antirad_scene::{Camera, Painting, Scene};
use glam::DVec3;

/// How pictures are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct RenderOptions {
    /// Each pixel is the mean of `supersample` x `supersample` samples on a rotated grid; a power of two. At edges of lamps there are more:
    /// [`Rasterizer::coverage`].
    pub supersample: u32,
    /// Gathered light at each visible point, or one colour per face.
    pub shading: Shading,
    /// How gathered pictures find what glossy faces mirror.
    pub reflections: Reflections,
}

setters!(RenderOptions { supersample: u32, shading: Shading, reflections: Reflections });

impl Default for RenderOptions {
    /// 8 x 8 samples, gathered, with as many rays as accuracy needs.
    fn default() -> Self {
        Self { supersample: 8, shading: Shading::default(), reflections: Reflections::default() }
    }
}

/// The light of a solution towards some cameras, on the host. It outlives its engine.
#[derive(Clone, Debug)]
pub enum Shown {
    /// Per camera, the radiance of each face towards it, W/(m² sr).
    Faces(Vec<Vec<[f64; 3]>>),
    /// What is gathered at each visible point.
    Gathered(Box<Light>),
}

/// A camera of a [`Shown`] light, what it sees, and the derivative of a loss by its pixels.
#[derive(Clone, Copy)]
pub struct SeenPixels<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// What it sees.
    pub coverage: &'a Coverage,
    /// Derivative of the loss by RGB and alpha of each pixel, row by row from the top; alpha does not depend
    /// on light.
    pub by_pixels: &'a [[f64; 4]],
}

/// What derivatives of pictures are wanted, and how accurately.
#[derive(Clone, Copy, Debug)]
pub struct PullBack<'a> {
    /// The kinds, all of which the engine's plan has.
    pub request: GradientRequest,
    /// The vertices by which derivatives are wanted, as in [`Engine::set_movable`]; `None`: all.
    pub movable: Option<&'a [u32]>,
    /// Textures by whose texels derivatives are wanted.
    pub paintings: &'a [Painting],
    /// When the adjoint solve stops.
    pub params: SolveParams,
}

/// Makes pictures of solved scenes on a backend, and pulls derivatives back through them.
#[derive(Debug)]
pub struct Renderer {
    rasterizer: Rasterizer,
    ranks: Ranks,
    options: RenderOptions,
}

impl Renderer {
    /// Compiles the kernel of pictures, if the backend takes one.
    ///
    /// # Errors
    /// Fails if the kernel cannot be compiled.
    pub fn new(backend: impl Into<Backend>, options: RenderOptions) -> Result<Self, ImageError> {
        let backend = backend.into();
        Ok(Self { ranks: backend.ranks().clone(), rasterizer: Rasterizer::new(backend)?, options })
    }

    /// This renderer with another shading.
    #[must_use]
    pub fn shading(self, shading: Shading) -> Self {
        Self { options: self.options.shading(shading), ..self }
    }

    /// How it makes pictures.
    pub fn options(&self) -> &RenderOptions {
        &self.options
    }

    /// What a camera sees of a scene. Of several ranks all must ask at once.
    ///
    /// # Errors
    /// Fails if the scene, the camera or the options are invalid, or if the device fails.
    pub fn coverage(&self, scene: &Scene, camera: &Camera) -> Result<Coverage, ImageError> {
        self.rasterizer.coverage(scene, camera, self.options.supersample)
    }

    /// What a camera sees of a scene whose vertices have moved. `before`: the vertices and the coverage
    /// before they moved. Only what moved faces may touch is computed anew.
    ///
    /// # Errors
    /// Fails as [`Self::coverage`] does.
    #[doc(hidden)]
    pub fn coverage_of_moved(
        &self,
        scene: &Scene,
        camera: &Camera,
        before: (&[DVec3], &Coverage),
    ) -> Result<Coverage, ImageError> {
        self.rasterizer.coverage_of_moved(scene, camera, self.options.supersample, before)
    }

    /// Reads the light towards some cameras from the latest solution of an engine for a scene. `before`: that of earlier pictures, from
    /// which is taken over what geometry alone decides, if that is the same.
    ///
    /// # Errors
    /// Fails if the solution belongs to another engine or to other materials, or if the device fails.
    pub fn light(
        &self,
        engine: &mut Engine,
        solution: &Solution,
        scene: &Scene,
        cameras: &[Camera],
        before: Option<&Shown>,
    ) -> Result<Shown, EngineError> {
        if self.options.shading == Shading::Face {
            let colours = cameras.iter().map(|camera| engine.face_colours(solution, camera.position));
            return Ok(Shown::Faces(colours.collect::<Result<_, _>>()?));
        }
        let light = Light::new(engine, solution, scene, cameras, self.options.reflections)?;
        Ok(Shown::Gathered(Box::new(match before {
            Some(Shown::Gathered(before)) => light.like(before),
            _ => light,
        })))
    }

    /// The pixels of a view, and how accurate they are. Ranks compute them in shares, and must all ask for them.
    ///
    /// # Errors
    /// Fails if coverage and light are of different scenes, or if ranks can no longer work together.
    pub fn pixels(&self, light: &Shown, view: usize, coverage: &Coverage) -> Result<Gathered, ImageError> {
        match light {
            Shown::Faces(colours) => Ok(Gathered { pixels: coverage.pixels(&colours[view])?, error: 0.0 }),
            Shown::Gathered(light) => light.gathered(view, coverage),
        }
    }

    /// The pictures of a solved scene.
    ///
    /// # Errors
    /// Fails as [`Self::coverage`], [`Self::light`] and [`Self::pixels`] do.
    pub fn pictures(
        &self,
        engine: &mut Engine,
        solution: &Solution,
        scene: &Scene,
        cameras: &[Camera],
    ) -> Result<Vec<Picture>, PictureError> {
        let light = self.light(engine, solution, scene, cameras, None)?;
        let picture = |(view, camera): (usize, &Camera)| {
            let coverage = self.coverage(scene, camera)?;
            Ok(self.pixels(&light, view, &coverage)?.picture(&coverage))
        };
        cameras.iter().enumerate().map(picture).collect()
    }

    /// The derivatives of a loss of pictures by everything that is requested: through the light of faces and what is gathered of it, and by
    /// vertices and cameras also through silhouettes that move in the picture. This is where all contributions are added.
    ///
    /// # Errors
    /// Fails if derivatives were not planned, if the adjoint solve fails or is stopped, or if rays tell what
    /// faces mirror in a way that has no derivatives.
    #[expect(clippy::too_many_arguments, reason = "what pictures were made of, and what is wanted of them")]
    pub fn pull_back(
        &self,
        engine: &mut Engine,
        solution: &Solution,
        scene: &Scene,
        light: &Shown,
        views: &[SeenPixels],
        wanted: PullBack,
        progress: &mut SolveProgress,
    ) -> Result<SceneGradient, PictureError> {
        let PullBack { request, params, paintings, .. } = wanted;
        let (gradients, by_points, texels) = match light {
            Shown::Gathered(light) => {
                let seen: Vec<SeenFrom> = views
                    .iter()
                    .map(|view| SeenFrom { coverage: view.coverage, by_pixels: view.by_pixels })
                    .collect();
                shading::backward(engine, solution, light, &seen, request, paintings, &params, progress)?
            }
            Shown::Faces(_) => {
                let mut cotangent = Cotangent::default();
                for view in views {
                    let by_colours = view.coverage.colour_gradient(view.by_pixels)?;
                    cotangent.colours.push((view.camera.position, by_colours));
                }
                let gradients = engine.backward_with(solution, &cotangent, request, &params, progress)?;
                (gradients, Vec::new(), TexelGradient::default())
            }
        };
        let mut gradient = SceneGradient::from(gradients);
        gradient.texels = gradient.albedo.as_ref().map(|albedo| by_texels(paintings, albedo, texels));
        for (camera, by_points) in gradient.cameras.iter_mut().flatten().zip(by_points) {
            *camera += by_points;
        }
        if request.geometry() {
            self.add_silhouettes(&mut gradient, scene, light, views, wanted)?;
        }
        Ok(gradient)
    }

    /// Adds the derivatives by silhouettes that move in the picture, beside those by the light of faces.
    fn add_silhouettes(
        &self,
        gradient: &mut SceneGradient,
        scene: &Scene,
        light: &Shown,
        views: &[SeenPixels],
        PullBack { request, movable, .. }: PullBack,
    ) -> Result<(), ImageError> {
        // All edges move with a camera.
        let movable = movable.filter(|_| !request.camera);
        let supersample = self.options.supersample;
        for (view, &SeenPixels { camera, by_pixels, .. }) in views.iter().enumerate() {
            let by_edges = match light {
                Shown::Gathered(light) => {
                    let (ranks, shown) = (&self.ranks, light.shown(view));
                    geometry_gradient_of(ranks, scene, camera, supersample, &shown, by_pixels, movable)?
                }
                Shown::Faces(colours) => {
                    geometry_gradient(scene, camera, supersample, &colours[view], by_pixels)?
                }
            };
            if let Some(positions) = &mut gradient.positions {
                positions.iter_mut().zip(by_edges.vertices).for_each(|(to, by)| *to += by);
            }
            if let Some(cameras) = &mut gradient.cameras {
                cameras[view] += by_edges.camera;
            }
        }
        Ok(())
    }
}

/// Derivatives by the texels of paintings: where pictures show them, and through the albedo of triangles, which is their mean.
fn by_texels(paintings: &[Painting], by_albedo: &[DVec3], of_pictures: TexelGradient) -> Vec<Vec<DVec3>> {
    let TexelGradient { shown, of_triangles } = of_pictures;
    let shown = shown.into_iter().map(Some).chain(std::iter::repeat(None));
    let of = |(painting, shown): (&Painting, Option<Vec<DVec3>>)| {
        let mut by_texels = shown.unwrap_or_else(|| vec![DVec3::ZERO; painting.texels()]);
        // What pictures show of a triangle's own albedo is in `shown` already.
        let through_mean = |t: usize| by_albedo[t] - of_triangles.get(t).copied().unwrap_or_default();
        painting.pull_back(through_mean, &mut by_texels);
        by_texels
    };
    paintings.iter().zip(shown).map(of).collect()
}
