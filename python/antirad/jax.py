"""Pictures of a scene as a differentiable function for JAX."""

import functools
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from antirad import Backend, Scene
from antirad._function import Function, given, sizes


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def _pictures(function, values):
    kind = jnp.result_type(float, *values)
    shapes = [jax.ShapeDtypeStruct(shape, kind) for shape in function.shapes]

    def pictures(values):
        return [picture.astype(kind) for picture in function.pictures(_arrays(values))]

    return jax.pure_callback(pictures, shapes, values, vmap_method="sequential")


def _forward(function, values):
    return _pictures(function, values), values


def _backward(function, values, cotangents):
    shapes = [jax.ShapeDtypeStruct(jnp.shape(value), jnp.result_type(value)) for value in values]

    def derivatives(values, cotangents):
        back = function.pull_back(_arrays(values), _arrays(cotangents))
        return [derivative.astype(shape.dtype) for derivative, shape in zip(back, shapes, strict=True)]

    return (jax.pure_callback(derivatives, shapes, values, cotangents, vmap_method="sequential"),)


_pictures.defvjp(_forward, _backward)


def _arrays(values):
    return [np.asarray(value) for value in values]


def render(
    scene: Scene,
    *,
    emission: jax.typing.ArrayLike | None = None,
    albedo: jax.typing.ArrayLike | None = None,
    specular: jax.typing.ArrayLike | None = None,
    diffuse: jax.typing.ArrayLike | None = None,
    power: jax.typing.ArrayLike | None = None,
    vertices: jax.typing.ArrayLike | None = None,
    camera: jax.typing.ArrayLike | None = None,
    textures: Mapping[str, jax.typing.ArrayLike] | None = None,
    views: str | Sequence[str] | None = None,
    supersample: int = 8,
    shading: str = "gathered",
    backend: Backend | None = None,
) -> jax.Array | tuple[jax.Array, ...]:
    """Render pictures of a scene, differentiable by the arrays given, also within `jit` and `vmap`.

    Arguments and errors are those of `antirad.torch.render`, with arrays of JAX in place of tensors. Only
    reverse mode is possible. Without `jax_enable_x64` values pass in single precision.

    Returns:
        An array (height, width, 3) for one name, or for a scene with one camera: linear RGB, rows from the
        top, W/(m² sr). Otherwise a tuple of them, one per view.

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
    textures = {name: jnp.asarray(texels) for name, texels in (textures or {}).items()}
    function = Function(scene, values, sizes(textures), views, supersample, shading, backend)
    arrays = [*values.values(), *textures.values()]
    pictures = _pictures(function, [jnp.asarray(value, jnp.result_type(float, value)) for value in arrays])
    return pictures[0] if function.one else tuple(pictures)
