from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, Literal, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Ambiguity",
    "Backend",
    "Camera",
    "DeviceError",
    "Engine",
    "Error",
    "Fit",
    "FitError",
    "FitResult",
    "Gradients",
    "Material",
    "PictureError",
    "Plan",
    "PlanError",
    "Refined",
    "Regulariser",
    "Renderer",
    "Resolved",
    "Scene",
    "SceneError",
    "Solution",
    "SolveError",
    "Target",
    "Warning",
    "__version__",
    "ambiguity",
    "check",
    "devices",
    "fit",
    "fit_job",
    "load_cameras",
    "load_targets",
    "plan",
    "read_picture",
    "refine",
    "write_picture",
]

__version__: str

_Path: TypeAlias = str | PathLike[str]
_Point: TypeAlias = Sequence[float]
_Rgb: TypeAlias = tuple[float, float, float]
_Triple: TypeAlias = float | Sequence[float]
_Kind: TypeAlias = Literal["emission", "albedo", "specular", "diffuse", "power", "vertices", "camera"]
_Quantity: TypeAlias = Literal["emission", "albedo", "diffuse", "specular", "power", "position", "camera"]
_SolveProgress: TypeAlias = Callable[[int, float, float], object] | bool | None
_FitProgress: TypeAlias = Callable[[dict[str, Any]], object] | bool | None
_StepsProgress: TypeAlias = Callable[[int, int], object] | bool | None

class Error(Exception): ...
class SceneError(Error): ...
class PlanError(Error): ...
class DeviceError(Error): ...
class SolveError(Error): ...
class PictureError(Error): ...
class FitError(Error): ...

@final
class Backend:
    def __new__(
        cls,
        kind: Literal["auto", "vulkan", "cpu"] = "auto",
        *,
        device: str | None = None,
        memory_budget: int | None = None,
        validation: bool | None = None,
    ) -> Backend: ...
    @property
    def kind(self) -> Literal["vulkan", "cpu"]: ...
    @property
    def device(self) -> str: ...
    @property
    def driver(self) -> str: ...
    @property
    def threads(self) -> int: ...
    @property
    def info(self) -> dict[str, Any] | None: ...
    @property
    def memory(self) -> dict[str, int]: ...
    @property
    def validation_messages(self) -> list[str]: ...

def devices() -> list[dict[str, Any]]: ...

@final
class Material:
    def __new__(
        cls,
        name: str,
        *,
        albedo: _Triple = 0.0,
        diffuse: float = 1.0,
        specular: _Triple = 0.0,
        power: float = 0.0,
        emission: _Triple = 0.0,
        normalization: Literal["phong", "energy"] = "phong",
    ) -> Material: ...
    @property
    def name(self) -> str: ...
    @property
    def albedo(self) -> _Rgb: ...
    @property
    def diffuse(self) -> float: ...
    @property
    def specular(self) -> _Rgb: ...
    @property
    def power(self) -> float: ...
    @property
    def emission(self) -> _Rgb: ...
    @property
    def normalization(self) -> str: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class Camera:
    def __new__(
        cls,
        position: _Point,
        target: _Point,
        *,
        up: _Point = (0.0, 1.0, 0.0),
        fov_x_degrees: float = 45.0,
        width: int = 256,
        height: int = 256,
        name: str = "camera",
    ) -> Camera: ...
    def replace(
        self,
        *,
        position: _Point | None = None,
        target: _Point | None = None,
        up: _Point | None = None,
        fov_x_degrees: float | None = None,
        width: int | None = None,
        height: int | None = None,
        name: str | None = None,
    ) -> Camera: ...
    @property
    def name(self) -> str: ...
    @property
    def position(self) -> _Rgb: ...
    @property
    def target(self) -> _Rgb: ...
    @property
    def up(self) -> _Rgb: ...
    @property
    def fov_x_degrees(self) -> float: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class Scene:
    @staticmethod
    def load(
        path: _Path,
        *,
        strict: bool = False,
        orient: Literal["auto", "keep"] = "auto",
        two_sided: bool = False,
    ) -> Scene: ...
    @staticmethod
    def from_arrays(
        vertices: ArrayLike,
        triangles: ArrayLike,
        materials: Sequence[Material],
        cameras: Sequence[Camera] = (),
        *,
        material_of: ArrayLike | None = None,
        meshes: Sequence[tuple[str, int]] | None = None,
        name: str = "scene",
    ) -> Scene: ...
    def with_sky(self, radiance: float | Sequence[float]) -> Scene: ...
    def with_sun(
        self,
        direction: Sequence[float],
        irradiance: float | Sequence[float],
        *,
        angular_diameter: float = 0.53,
    ) -> Scene: ...
    def save(self, path: _Path) -> None: ...
    def export(self, path: _Path) -> None: ...
    def replace(
        self,
        *,
        vertices: ArrayLike | None = None,
        emission: ArrayLike | None = None,
        albedo: ArrayLike | None = None,
        specular: ArrayLike | None = None,
        diffuse: ArrayLike | None = None,
        power: ArrayLike | None = None,
        cameras: Sequence[Camera] | None = None,
    ) -> Scene: ...
    def per_triangle(self) -> Scene: ...
    def with_settings(
        self,
        *,
        bins: str | None = None,
        near_field: float | None = None,
        tolerance: float | None = None,
        max_passes: int | None = None,
        solver: Literal["auto", "fixed-point", "gmres"] | None = None,
        precision: Literal["f32", "f64"] | None = None,
        lamps: Literal["auto", "exact", "sampled", "antiradiance"] | None = None,
        visibility: Literal["implicit", "explicit"] | None = None,
        ray_error: float | None = None,
    ) -> Scene: ...
    def resolved(self, *, cut: bool = True) -> Resolved: ...
    def camera(self, name: str | None = None) -> Camera: ...
    def place_of(self, triangle: int) -> str: ...
    @property
    def settings(self) -> dict[str, Any]: ...
    @property
    def name(self) -> str: ...
    @property
    def vertices(self) -> NDArray[np.float64]: ...
    @property
    def triangles(self) -> NDArray[np.int64]: ...
    @property
    def material_of(self) -> NDArray[np.int64]: ...
    @property
    def areas(self) -> NDArray[np.float64]: ...
    @property
    def materials(self) -> list[Material]: ...
    @property
    def cameras(self) -> list[Camera]: ...
    @property
    def suns(self) -> list[tuple[_Rgb, _Rgb, float]]: ...
    @property
    def meshes(self) -> list[tuple[str, range]]: ...
    @property
    def emission(self) -> NDArray[np.float64]: ...
    @property
    def albedo(self) -> NDArray[np.float64]: ...
    @property
    def specular(self) -> NDArray[np.float64]: ...
    @property
    def diffuse(self) -> NDArray[np.float64]: ...
    @property
    def power(self) -> NDArray[np.float64]: ...
    @property
    def degenerate(self) -> NDArray[np.int64]: ...
    @property
    def warnings(self) -> list[str]: ...

@final
class Plan:
    @property
    def total_bytes(self) -> int: ...
    @property
    def bytes(self) -> dict[str, int]: ...
    @property
    def memory_budget(self) -> int: ...
    def report(self) -> dict[str, Any]: ...

def plan(
    scene: Scene,
    *,
    backend: Backend | None = None,
    memory_budget: int | None = None,
    gradients: Sequence[_Kind] = (),
    cut: bool = True,
) -> Plan: ...

@final
class Engine:
    def __new__(
        cls,
        scene: Scene,
        *,
        backend: Backend | None = None,
        memory_budget: int | None = None,
        gradients: Sequence[_Kind] = (),
        cut: bool = True,
    ) -> Engine: ...
    @property
    def plan(self) -> Plan: ...
    @property
    def decisions(self) -> list[tuple[str, str, str]]: ...
    @property
    def backend(self) -> Backend: ...
    def solve(
        self,
        *,
        tolerance: float | None = None,
        max_passes: int | None = None,
        start: Solution | None = None,
        progress: _SolveProgress = None,
    ) -> Solution: ...
    def set_materials(self, scene: Scene) -> None: ...
    def face_colours(self, solution: Solution, position: _Point) -> NDArray[np.float64]: ...
    def render(
        self,
        solution: Solution,
        camera: Camera | None = None,
        *,
        supersample: int = 8,
        shading: Literal["gathered", "face"] = "gathered",
        reflections: Literal["rays", "fixed-rays", "bins"] = "rays",
    ) -> NDArray[np.float32]: ...
    def backward(
        self,
        solution: Solution,
        *,
        irradiance: ArrayLike | None = None,
        radiosity: ArrayLike | None = None,
        colours: Sequence[tuple[_Point, ArrayLike]] = (),
        tolerance: float | None = None,
        max_passes: int | None = None,
        progress: _SolveProgress = None,
    ) -> Gradients: ...

@final
class Solution:
    @property
    def irradiance(self) -> NDArray[np.float64]: ...
    @property
    def radiosity(self) -> NDArray[np.float64]: ...
    @property
    def passes(self) -> int: ...
    @property
    def residuals(self) -> list[float]: ...
    @property
    def spectral_radius(self) -> float | None: ...
    @property
    def energy(self) -> dict[str, _Rgb]: ...
    @property
    def negative(self) -> tuple[int, float]: ...

@final
class Gradients:
    @property
    def emission(self) -> NDArray[np.float64] | None: ...
    @property
    def suns(self) -> NDArray[np.float64] | None: ...
    @property
    def albedo(self) -> NDArray[np.float64] | None: ...
    @property
    def specular(self) -> NDArray[np.float64] | None: ...
    @property
    def diffuse(self) -> NDArray[np.float64] | None: ...
    @property
    def power(self) -> NDArray[np.float64] | None: ...
    @property
    def vertices(self) -> NDArray[np.float64] | None: ...
    @property
    def camera(self) -> NDArray[np.float64] | None: ...
    @property
    def textures(self) -> list[NDArray[np.float64]] | None: ...
    def by_material(self, scene: Scene) -> Gradients: ...

@final
class Renderer:
    def __new__(
        cls,
        scene: Scene,
        *,
        views: Sequence[str] | None = None,
        gradients: Sequence[_Kind] = (),
        supersample: int = 8,
        shading: Literal["gathered", "face"] = "gathered",
        textures: Sequence[tuple[str, int, int]] = (),
        backend: Backend | None = None,
    ) -> Renderer: ...
    def pictures(
        self,
        *,
        emission: ArrayLike | None = None,
        albedo: ArrayLike | None = None,
        specular: ArrayLike | None = None,
        diffuse: ArrayLike | None = None,
        power: ArrayLike | None = None,
        vertices: ArrayLike | None = None,
        camera: ArrayLike | None = None,
        textures: Sequence[ArrayLike] = (),
    ) -> list[NDArray[np.float64]]: ...
    def pull_back(
        self,
        by_pixels: Sequence[ArrayLike],
        *,
        emission: ArrayLike | None = None,
        albedo: ArrayLike | None = None,
        specular: ArrayLike | None = None,
        diffuse: ArrayLike | None = None,
        power: ArrayLike | None = None,
        vertices: ArrayLike | None = None,
        camera: ArrayLike | None = None,
        textures: Sequence[ArrayLike] = (),
    ) -> Gradients: ...
    @property
    def views(self) -> list[tuple[str, int, int]]: ...
    @property
    def passes(self) -> int: ...

@final
class Warning:
    @property
    def kind(self) -> str: ...
    @property
    def effect(self) -> float: ...
    @property
    def message(self) -> str: ...
    @property
    def remedy(self) -> str: ...
    @property
    def triangles(self) -> NDArray[np.int64]: ...
    @property
    def area_share(self) -> float: ...
    @property
    def measure(self) -> str: ...
    @property
    def worst(self) -> list[dict[str, Any]]: ...

@final
class Resolved:
    @property
    def scene(self) -> Scene: ...
    @property
    def decisions(self) -> list[tuple[str, str, str]]: ...
    @property
    def parents(self) -> NDArray[np.int64]: ...
    def on_given(self, values: ArrayLike) -> NDArray[np.float64]: ...

@final
class Refined:
    @property
    def scene(self) -> Scene: ...
    @property
    def parents(self) -> NDArray[np.int64]: ...
    @property
    def rounds(self) -> int: ...
    @property
    def full(self) -> bool: ...
    @property
    def before(self) -> list[Warning]: ...
    @property
    def after(self) -> list[Warning]: ...

def check(scene: Scene) -> list[Warning]: ...
def refine(scene: Scene, *, max_triangles: int = 100_000, levels: int = 4) -> Refined: ...

@final
class Fit:
    def __new__(
        cls,
        quantity: _Quantity,
        *,
        materials: Sequence[str] | None = None,
        meshes: Sequence[str] | None = None,
        cameras: Sequence[str] | None = None,
        per: Literal["material", "mesh", "segment", "triangle", "texel"] = "material",
        resolution: int | None = None,
        motion: Literal["rigid", "translation", "scale", "similarity", "vertices"] = "rigid",
        together: bool = False,
        lower: _Triple | None = None,
        upper: _Triple | None = None,
        initial: _Triple | None = None,
        max_rotation_degrees: float | None = None,
        max_scale: float | None = None,
    ) -> Fit: ...

@final
class Target:
    def __new__(
        cls,
        camera: Camera,
        picture: ArrayLike,
        *,
        mask: ArrayLike | None = None,
        weight: float = 1.0,
        noise: tuple[float, float] | None = None,
    ) -> Target: ...
    @property
    def camera(self) -> Camera: ...
    @property
    def picture(self) -> NDArray[np.float64]: ...

@final
class Regulariser:
    @staticmethod
    def smoothness(of: _Quantity, weight: float) -> Regulariser: ...
    @staticmethod
    def laplacian(weight: float) -> Regulariser: ...
    @staticmethod
    def sparsity(weight: float) -> Regulariser: ...
    @staticmethod
    def total_variation(weight: float) -> Regulariser: ...
    @staticmethod
    def prior(
        of: _Quantity,
        weight: float,
        value: _Triple | None = None,
        names: Sequence[str] | None = None,
    ) -> Regulariser: ...

@final
class FitResult:
    @property
    def scene(self) -> Scene: ...
    @property
    def recovered(self) -> list[dict[str, Any]]: ...
    @property
    def history(self) -> list[dict[str, Any]]: ...
    @property
    def pictures(self) -> list[NDArray[np.float64]]: ...
    @property
    def loss(self) -> float: ...
    @property
    def stop(self) -> str: ...
    @property
    def seconds(self) -> float: ...
    @property
    def warnings(self) -> list[str]: ...

def fit(
    scene: Scene,
    targets: Sequence[Target],
    fits: Sequence[Fit],
    *,
    loss: Literal["l2", "l1", "relative-l2", "log-l1", "huber"] = "l2",
    epsilon: float | None = None,
    regularisers: Sequence[Regulariser] = (),
    optimiser: Literal["auto", "quasi-newton", "adam", "least-squares"] = "auto",
    learning_rate: float | None = None,
    iterations: int = 200,
    relative_decrease: float = 1e-4,
    seconds: float | None = None,
    supersample: int | None = None,
    tolerance: float | None = None,
    checkpoints: _Path | None = None,
    resume: bool = False,
    backend: Backend | None = None,
    progress: _FitProgress = None,
) -> FitResult: ...
def fit_job(
    path: _Path,
    *,
    iterations: int | None = None,
    checkpoints: _Path | None = None,
    resume: bool = False,
    backend: Backend | None = None,
    progress: _FitProgress = None,
) -> FitResult: ...

@final
class Ambiguity:
    @property
    def seen(self) -> NDArray[np.bool_]: ...
    @property
    def unseen(self) -> NDArray[np.int64]: ...
    @property
    def least(self) -> NDArray[np.float64]: ...
    @property
    def most(self) -> NDArray[np.float64]: ...
    @property
    def determination(self) -> NDArray[np.float64]: ...

def ambiguity(
    scene: Scene,
    *,
    views: Sequence[str] | None = None,
    noise: float = 1e-3,
    supersample: int = 8,
    backend: Backend | None = None,
    progress: _StepsProgress = None,
) -> Ambiguity: ...
def load_cameras(path: _Path) -> list[Camera]: ...
def load_targets(
    path: _Path,
    *,
    images: _Path | None = None,
    suffix: str | None = None,
    mask: _Path | None = None,
    segments: _Path | None = None,
    noise: tuple[float, float] | None = None,
    layer: str | None = None,
    every: int = 1,
    response: Literal["srgb", "linear", "gamma", "fit"] | None = None,
    gamma: float = 2.2,
    pixels: int = 2_000_000,
) -> list[Target]: ...
def read_picture(path: _Path, *, white: float = 1.0) -> NDArray[np.float64]: ...
def write_picture(
    path: _Path, picture: ArrayLike, *, exposure: float | None = None, srgb: bool = True
) -> None: ...
