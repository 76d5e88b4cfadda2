"""Pictures of a scene as a differentiable function for PyTorch."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from antirad import Backend, Scene
from antirad._function import Function, given, sizes


class _Pictures(torch.autograd.Function):
    @staticmethod
    def forward(ctx, function, *tensors):
        ctx.function = function
        ctx.save_for_backward(*tensors)
        pictures = function.pictures([_array(tensor) for tensor in tensors])
        kind = tensors[0].dtype if tensors else torch.get_default_dtype()
        for tensor in tensors[1:]:
            kind = torch.promote_types(kind, tensor.dtype)
        return tuple(torch.from_numpy(picture).to(kind) for picture in pictures)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *cotangents):
        tensors = ctx.saved_tensors
        if not any(ctx.needs_input_grad):
            return (None,) * (1 + len(tensors))
        cotangents = [
            np.zeros(shape) if cotangent is None else _array(cotangent)
            for cotangent, shape in zip(cotangents, ctx.function.shapes, strict=True)
        ]
        derivatives = ctx.function.pull_back([_array(tensor) for tensor in tensors], cotangents)
        back = [
            torch.from_numpy(derivative).to(dtype=tensor.dtype, device=tensor.device)
            for derivative, tensor in zip(derivatives, tensors, strict=True)
        ]
        return None, *back


def _array(tensor):
    return tensor.detach().cpu().numpy()


def render(
    scene: Scene,
    *,
    emission: torch.Tensor | None = None,
    albedo: torch.Tensor | None = None,
    specular: torch.Tensor | None = None,
    diffuse: torch.Tensor | None = None,
    power: torch.Tensor | None = None,
    vertices: torch.Tensor | None = None,
    camera: torch.Tensor | None = None,
    textures: Mapping[str, torch.Tensor] | None = None,
    views: str | Sequence[str] | None = None,
    supersample: int = 8,
    shading: str = "gathered",
    backend: Backend | None = None,
) -> torch.Tensor | tuple[torch.Tensor, ...]:
    """Render pictures of a scene, differentiable by the tensors given.

    Values that are None are the scene's own. M is the number of materials, V that of vertices, n that of
    views. For a value per triangle, use `scene.per_triangle()`.

    The derivatives are those of the discretised model, by one adjoint solve however many values there are.
    Pixels are means over samples, while derivatives by positions are those of exact areas.

    Args:
        scene: An `antirad.Scene`. It keeps the memory of its last call; delete it to free that.
        emission: Emitted radiance of each material, (M, 3), W/(m² sr). It may be negative.
        albedo: Albedo ρ of each material, (M, 3).
        specular: Specular constant σ of each material, (M, 3).
        diffuse: Diffuse constant δ of each material, (M,).
        power: Power p of each material, (M,).
        vertices: Positions, (V, 3), metres.
        camera: Position and target of each view, (n, 2, 3), or (2, 3) for one, metres; with up (n, 3, 3)
            or (3, 3).
        textures: Albedo of the texels of a mesh by its name, (rows, columns, 3) each, from 0 to below 1, in
            place of that of its materials. The first row is at v = 0 of its texture coordinates: the top of a
            picture of glTF, and the bottom of one of OBJ. A mesh without any gets those of an atlas.
        views: Names of cameras, or one name; by default all cameras of the scene.
        supersample: Samples along each side of a pixel, a power of two.
        shading: "gathered" (direct light at each visible point, indirect light interpolated) or "face" (one
            colour per triangle), which `camera` requires.
        backend: An `antirad.Backend`; by default the one that all such calls share, of the kind that the
            settings of the scene name.

    Returns:
        A tensor (height, width, 3) for one name, or for a scene with one camera: linear RGB, rows from the
        top, W/(m² sr). Otherwise a tuple of them, one per view. On the CPU, in the common type of the tensors
        given.

    Raises:
        ValueError: A tensor has the wrong shape, or there is no such camera.
        antirad.SceneError: The values are no valid scene, for instance an albedo of 1 or more.
        antirad.SolveError: The scene has no solution.

    """
    values = given(
        emission=emission,
        albedo=albedo,
        specular=specular,
        diffuse=diffuse,
        power=power,
        vertices=vertices,
        camera=camera,
    )
    textures = {name: torch.as_tensor(texels) for name, texels in (textures or {}).items()}
    function = Function(scene, values, sizes(textures), views, supersample, shading, backend)
    tensors = [torch.as_tensor(value) for value in values.values()]
    pictures = _Pictures.apply(function, *tensors, *textures.values())
    return pictures[0] if function.one else pictures
