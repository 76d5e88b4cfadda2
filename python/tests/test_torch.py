"""Gradients of `antirad.torch.render` against central differences and as a transpose."""

import numpy as np
import pytest
from rooms import exact, room

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

import antirad  # noqa: E402
import antirad.torch  # noqa: E402


def tensor(values):
    return torch.tensor(values, dtype=torch.float64, requires_grad=True)


@pytest.fixture(scope="module")
def scene():
    scene = exact(room(width=5, height=4))
    return scene.replace(specular=np.full((3, 3), 0.05), power=[2.0, 8.0, 1.0])


def test_gradcheck(scene):
    kinds = ("emission", "albedo", "diffuse", "specular", "power")
    values = [tensor(getattr(scene, kind)) for kind in kinds]

    def render(*values):
        return antirad.torch.render(scene, **dict(zip(kinds, values, strict=True)))

    assert torch.autograd.gradcheck(render, values, eps=1e-4, atol=1e-7, rtol=1e-5, fast_mode=True)


def test_it_is_a_transpose():
    """⟨J v, w⟩ = ⟨v, Jᵀ w⟩ in all materials at once, with J v from central differences."""
    scene = exact(room())
    random = np.random.default_rng(3)
    point = {kind: getattr(scene, kind) for kind in ("emission", "albedo")}
    way = {kind: random.standard_normal(value.shape) for kind, value in point.items()}

    def at(step):
        values = {kind: torch.tensor(point[kind] + step * way[kind]) for kind in point}
        return antirad.torch.render(scene, **values)

    weights = torch.tensor(random.standard_normal((8, 12, 3)))
    forward = (weights * (at(1e-5) - at(-1e-5))).sum() / 2e-5
    values = {kind: tensor(value) for kind, value in point.items()}
    (weights * antirad.torch.render(scene, **values)).sum().backward()
    backward = sum((torch.tensor(way[kind]) * values[kind].grad).sum() for kind in point)
    assert backward.item() == pytest.approx(forward.item(), rel=1e-7)


def smooth_weights(height, width):
    y, x = np.mgrid[0:height, 0:width]
    return torch.tensor(
        (1 + 0.5 * np.cos(4 * x / width) * np.sin(3 * y / height))[..., None] * [1.0, 0.8, 0.6]
    )


def weighted_mean(scene, shading="gathered", **values):
    picture = antirad.torch.render(scene, supersample=16, shading=shading, **values)
    return (smooth_weights(*picture.shape[:2]) * picture).mean()


def differences(loss, start, ways, step):
    def along(way):
        above, below = (loss(torch.tensor(start + sign * step * way)).item() for sign in (1, -1))
        return (above - below) / (2 * step)

    return np.array([along(way) for way in ways])


def test_a_block_that_moves():
    """Silhouettes included: edges pass over finely sampled pixels while the light changes."""
    scene = exact(room(width=64, height=48)).with_settings(bins="6x9")
    of_block = np.unique(scene.triangles[list(scene.meshes[1][1])])
    ways = np.zeros((3, *scene.vertices.shape))
    for axis in range(3):
        ways[axis, of_block, axis] = 1

    def loss(vertices):
        return weighted_mean(scene, vertices=vertices)

    vertices = tensor(scene.vertices)
    loss(vertices).backward()
    gradient = (ways * vertices.grad.numpy()).sum((1, 2))
    expected = differences(loss, scene.vertices, ways, 0.0025)
    assert np.linalg.norm(gradient - expected) <= 0.02 * np.linalg.norm(expected)


def test_a_camera_that_moves():
    scene = exact(room(width=64, height=48))
    view = scene.camera()
    start = np.array([view.position, view.target])

    def loss(camera):
        return weighted_mean(scene, camera=camera)

    camera = tensor(start)
    loss(camera).backward()
    expected = differences(loss, start, np.eye(6).reshape(6, 2, 3), 0.02)
    assert np.linalg.norm(camera.grad.numpy().ravel() - expected) <= 0.01 * np.linalg.norm(expected)


def test_types_and_shapes_follow_the_arguments():
    scene = room()
    albedo = torch.tensor(scene.albedo, dtype=torch.float32, requires_grad=True)
    picture = antirad.torch.render(scene, albedo=albedo)
    assert picture.shape == (8, 12, 3) and picture.dtype == torch.float32
    picture.sum().backward()
    assert albedo.grad.dtype == torch.float32 and albedo.grad.abs().sum() > 0
    plain = antirad.torch.render(scene)
    assert not plain.requires_grad
    assert plain.numpy() == pytest.approx(picture.detach().numpy(), abs=1e-6)


def test_several_views():
    scene = room()
    side = scene.camera().replace(position=(-0.8, 0.5, 0.8), width=6, height=6, name="side")
    scene = scene.replace(cameras=[scene.camera(), side])
    emission = tensor(scene.emission)
    pictures = antirad.torch.render(scene, emission=emission)
    assert [tuple(picture.shape) for picture in pictures] == [(8, 12, 3), (6, 6, 3)]
    # Only one of them matters.
    pictures[1].sum().backward()
    of_both = emission.grad.clone()
    emission.grad = None
    antirad.torch.render(scene, emission=emission, views="side").sum().backward()
    assert emission.grad.numpy() == pytest.approx(of_both.numpy(), rel=1e-3)


def test_a_graph_of_several_renderings():
    """The derivative of an earlier picture is taken at its own point, not at that of the latest one."""
    scene = exact(room())
    dim, bright = tensor(scene.albedo * 0.5), tensor(scene.albedo)
    loss = (antirad.torch.render(scene, albedo=dim) * antirad.torch.render(scene, albedo=bright)).sum()
    loss.backward()
    alone = tensor(scene.albedo * 0.5)
    (
        antirad.torch.render(scene, albedo=alone) * antirad.torch.render(scene, albedo=bright).detach()
    ).sum().backward()
    assert torch.equal(dim.grad, alone.grad)


def test_torch_errors_are_those_of_antirad():
    scene = room()
    with pytest.raises(antirad.SceneError, match="below 1"):
        antirad.torch.render(scene, albedo=torch.ones(3, 3))
    with pytest.raises(ValueError, match=r"albedo has the shape \(3,\)"):
        antirad.torch.render(scene, albedo=torch.ones(3))


def test_per_triangle_emission():
    scene = exact(room(cells=2)).per_triangle()
    emission = tensor(scene.emission)
    picture = antirad.torch.render(scene, emission=emission)
    # Linear: the picture is the derivative times the emission, for any weights.
    picture.sum().backward()
    assert (emission.grad * emission.detach()).sum().item() == pytest.approx(picture.sum().item(), rel=1e-9)


def test_it_fits_with_an_optimiser():
    scene = room()
    own = torch.tensor(scene.emission)
    target = antirad.torch.render(scene, emission=own)
    factor = torch.tensor(0.5, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([factor], line_search_fn="strong_wolfe")

    def closure():
        optimiser.zero_grad()
        loss = ((antirad.torch.render(scene, emission=factor * own) - target) ** 2).mean()
        loss.backward()
        return loss

    optimiser.step(closure)
    assert factor.item() == pytest.approx(1, abs=1e-3)
