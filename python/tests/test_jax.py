"""Gradients of `antirad.jax.render` against central differences and as a transpose."""

import numpy as np
import pytest
from rooms import exact, room, textured

jax = pytest.importorskip("jax", reason="JAX is not installed")

import jax.numpy as jnp  # noqa: E402
from jax.test_util import check_grads  # noqa: E402

import antirad  # noqa: E402
import antirad.jax  # noqa: E402


@pytest.fixture(autouse=True)
def double_precision():
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


@pytest.fixture(scope="module")
def scene():
    scene = exact(room(width=5, height=4))
    return scene.replace(specular=np.full((3, 3), 0.05), power=[2.0, 8.0, 1.0])


def test_check_grads(scene):
    kinds = ("emission", "albedo", "specular", "diffuse", "power")

    def render(*values):
        return antirad.jax.render(scene, **dict(zip(kinds, values, strict=True)))

    values = [jnp.asarray(getattr(scene, kind)) for kind in kinds]
    check_grads(render, values, order=1, modes=["rev"], eps=1e-4, atol=1e-6, rtol=1e-5)


def test_check_grads_by_texels(tmp_path):
    scene = exact(textured(tmp_path, width=5, height=4))

    def render(floor, emission):
        return antirad.jax.render(scene, emission=emission, textures={"floor": floor})

    texels = jnp.asarray(0.2 + 0.6 * np.random.default_rng(1).random((2, 3, 3)))
    values = (texels, jnp.asarray(scene.emission))
    check_grads(render, values, order=1, modes=["rev"], eps=1e-4, atol=1e-6, rtol=1e-5)


def test_it_is_a_transpose():
    scene = exact(room())
    random = np.random.default_rng(5)
    albedo, way = jnp.asarray(scene.albedo), random.standard_normal((3, 3))
    weights = random.standard_normal((8, 12, 3))

    def render(albedo):
        return antirad.jax.render(scene, albedo=albedo)

    step = 1e-5
    forward = (weights * (render(albedo + step * way) - render(albedo - step * way))).sum() / (2 * step)
    _, pull_back = jax.vjp(render, albedo)
    (derivative,) = pull_back(jnp.asarray(weights))
    assert float((derivative * way).sum()) == pytest.approx(float(forward), rel=1e-7)


def test_jit_and_vmap():
    scene = room()

    @jax.jit
    def brightness(emission):
        return antirad.jax.render(scene, emission=emission).mean()

    emission = jnp.asarray(scene.emission)
    value, derivative = jax.value_and_grad(brightness)(emission)
    # Linear in emission.
    assert float((derivative * emission).sum()) == pytest.approx(float(value), rel=1e-3)
    both = jax.vmap(brightness)(jnp.stack([emission, 2 * emission]))
    assert np.asarray(both) == pytest.approx([float(value), 2 * float(value)], rel=1e-4)


def test_the_camera_and_several_views():
    scene = room()
    side = scene.camera().replace(position=(-0.8, 0.5, 0.8), width=6, height=6, name="side")
    scene = scene.replace(cameras=[scene.camera(), side])
    camera = jnp.array([[view.position, view.target] for view in scene.cameras])

    def loss(camera):
        main, side = antirad.jax.render(scene, camera=camera)
        assert main.shape == (8, 12, 3) and side.shape == (6, 6, 3)
        return side.sum()

    derivative = jax.grad(loss)(camera)
    assert derivative.shape == (2, 2, 3)
    assert not derivative[0].any() and derivative[1].any()


def test_single_precision():
    jax.config.update("jax_enable_x64", False)
    scene = room()
    picture = antirad.jax.render(scene, albedo=jnp.asarray(scene.albedo))
    assert picture.dtype == jnp.float32
    assert np.asarray(picture) == pytest.approx(np.asarray(antirad.jax.render(scene)), abs=1e-5)
