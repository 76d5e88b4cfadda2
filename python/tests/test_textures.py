"""Albedo textures as arguments of `antirad.torch.render`."""

import numpy as np
import pytest
from rooms import exact, textured

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

import antirad.torch  # noqa: E402


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return exact(textured(tmp_path_factory.mktemp("scene")))


def texels(rows, columns, seed=1):
    values = 0.2 + 0.6 * np.random.default_rng(seed).random((rows, columns, 3))
    return torch.tensor(values, requires_grad=True)


def test_derivatives_by_texels_are_differences(scene):
    """Of single texels, in each channel and together with what else is unknown."""
    floor, albedo = texels(3, 4), torch.tensor(scene.albedo, requires_grad=True)
    weights = torch.tensor(np.random.default_rng(2).standard_normal((8, 12, 3)))

    def loss(floor, albedo):
        picture = antirad.torch.render(scene, albedo=albedo, textures={"floor": floor})
        return (weights * picture**2).sum()

    loss(floor, albedo).backward()
    step = 1e-4
    for value, at in [(floor, (0, 0, 0)), (floor, (1, 2, 1)), (floor, (2, 3, 2)), (albedo, (0, 1))]:
        moved = []
        for sign in (1, -1):
            there = value.detach().clone()
            there[at] += sign * step
            moved.append(loss(there, albedo) if value is floor else loss(floor, there))
        difference = (moved[0] - moved[1]).item() / (2 * step)
        assert difference != 0
        assert value.grad[at].item() == pytest.approx(difference, rel=1e-5)


def test_an_even_texture_is_an_albedo(scene):
    """The floor's material no longer counts, and that of the wall, which is the same, does."""
    albedo = torch.tensor(scene.albedo)
    picture = antirad.torch.render(scene, textures={"floor": torch.full((5, 2, 3), 0.5, dtype=torch.float64)})
    assert picture.numpy() == pytest.approx(antirad.torch.render(scene).numpy(), rel=1e-6)
    albedo[0] = 0.2
    darker = antirad.torch.render(scene, albedo=albedo)
    mixed = antirad.torch.render(scene, albedo=albedo, textures={"floor": torch.full((2, 2, 3), 0.5)})
    assert darker.mean() < mixed.mean() < picture.mean()


def test_rows_go_up_with_v(scene):
    """The first row is at v = 0, where z = 0: beside the wall, at the top of the picture."""
    texture = torch.full((4, 2, 3), 0.1)
    texture[2:] = 0.9
    picture = antirad.torch.render(scene, textures={"floor": texture})
    turned = antirad.torch.render(scene, textures={"floor": texture.flip(0)})
    assert picture[-1].mean() > 4 * turned[-1].mean()


def test_a_mesh_without_coordinates_gets_an_atlas(scene):
    wall = texels(16, 16)
    antirad.torch.render(scene, textures={"wall": wall, "floor": texels(2, 2)}).sum().backward()
    assert (wall.grad > 0).any()


def test_a_texture_is_found(scene):
    truth = texels(2, 3, seed=5).detach()
    target = antirad.torch.render(scene, textures={"floor": truth})
    found = torch.full((2, 3, 3), 0.5, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([found], max_iter=60, line_search_fn="strong_wolfe", tolerance_change=1e-14)

    def closure():
        optimiser.zero_grad()
        picture = antirad.torch.render(scene, textures={"floor": found.clamp(0, 0.99)})
        loss = 100 * ((picture - target) ** 2).mean()
        loss.backward()
        return loss

    optimiser.step(closure)
    assert found.detach().numpy() == pytest.approx(truth.numpy(), abs=0.01)


def test_what_is_no_texture(scene):
    for textures, message in [
        ({"flor": texels(2, 2)}, 'no mesh "flor"; the scene has floor, wall, lamp'),
        ({"floor": torch.ones(2, 2)}, r"'floor' has the shape \(2, 2\); it must be \(rows, columns, 3\)"),
        ({"floor": torch.ones(2, 2, 3)}, "row 0, column 0; an albedo must be 0 or more and below 1"),
        ({"floor": torch.ones(0, 2, 3)}, "no texels"),
    ]:
        with pytest.raises(ValueError, match=message):
            antirad.torch.render(scene, textures=textures)
