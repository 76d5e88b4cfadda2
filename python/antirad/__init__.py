"""Differentiable global illumination of triangle meshes, by radiosity, on GPUs and CPUs.

>>> import antirad
>>> scene = antirad.Scene.load("scenes/cornell_boxes.toml")
>>> engine = antirad.Engine(scene)
>>> solution = engine.solve()
>>> antirad.write_picture("room.png", engine.render(solution))

Units are SI: metres, W/m², W/(m² sr). Light is RGB. Arrays are NumPy's, with one row per triangle, vertex
or material of the scene, in its order. `antirad.torch` and `antirad.jax` give pictures as differentiable
functions of a scene's values.

Work runs without the GIL. Ctrl-C stops it. Errors are subclasses of `antirad.Error`; their messages say what
to do.
"""

from antirad._antirad import (
    Ambiguity,
    Backend,
    Camera,
    DeviceError,
    Engine,
    Error,
    Fit,
    FitError,
    FitResult,
    Gradients,
    Material,
    PictureError,
    Plan,
    PlanError,
    Refined,
    Regulariser,
    Renderer,
    Resolved,
    Scene,
    SceneError,
    Solution,
    SolveError,
    Target,
    Warning,
    __version__,
    ambiguity,
    check,
    devices,
    fit,
    fit_job,
    load_cameras,
    load_targets,
    plan,
    read_picture,
    refine,
    write_picture,
)

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
