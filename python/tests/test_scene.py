from pathlib import Path

import numpy as np
import pytest
from rooms import room

import antirad

SCENES = Path(__file__).resolve().parents[2] / "scenes"


def test_a_scene_file_is_loaded():
    scene = antirad.Scene.load(SCENES / "cornell_boxes.toml")
    assert scene.triangles.shape == (3092, 3) and scene.triangles.dtype == np.int64
    assert scene.vertices.dtype == np.float64
    assert scene.material_of.max() < len(scene.materials) == len(scene.albedo)
    assert scene.camera().width == 256
    assert "cornell_boxes" in repr(scene)


def test_arrays_come_back_as_they_went_in():
    scene = room()
    again = antirad.Scene.from_arrays(
        scene.vertices, scene.triangles, scene.materials, scene.cameras, material_of=scene.material_of
    )
    assert np.array_equal(again.vertices, scene.vertices)
    assert np.array_equal(again.triangles, scene.triangles)
    assert again.materials == scene.materials and again.cameras == scene.cameras
    assert [name for name, _ in scene.meshes] == ["walls", "block", "lamp"]
    assert scene.meshes[1][1] == range(48, 60)
    assert scene.areas.sum() == pytest.approx(24 + 6 * 0.36 + 0.36)


def test_a_saved_scene_is_the_same(tmp_path):
    scene = room()
    scene.save(tmp_path / "room.toml")
    again = antirad.Scene.load(tmp_path / "room.toml")
    assert np.array_equal(again.vertices[again.triangles], scene.vertices[scene.triangles])
    assert np.array_equal(again.albedo[again.material_of], scene.albedo[scene.material_of])


def test_an_exported_scene_is_read_again(tmp_path):
    scene = room()
    for name in ["room.glb", "room.xml", "room.ply"]:
        scene.export(tmp_path / name)
        again = antirad.Scene.load(tmp_path / name)
        assert again.areas.sum() == pytest.approx(scene.areas.sum(), rel=1e-6), name
        assert again.emission.max() == pytest.approx(0 if name.endswith("ply") else scene.emission.max())
    with pytest.raises(ValueError, match=r"expected \.glb, \.xml or \.ply"):
        scene.export(tmp_path / "room.obj")


def test_values_are_replaced_and_the_given_scene_stays():
    scene = room()
    changed = scene.replace(albedo=scene.albedo / 2, vertices=scene.vertices + 1.0)
    assert np.array_equal(changed.albedo, scene.albedo / 2)
    assert np.array_equal(changed.vertices, scene.vertices + 1.0)
    assert scene.albedo[0, 0] == 0.6
    # What a getter returns is a copy.
    scene.vertices[:] = 0
    assert scene.vertices.any()


def test_per_triangle_gives_each_triangle_a_material():
    scene = room()
    own = scene.per_triangle()
    assert np.array_equal(own.material_of, np.arange(len(scene.triangles)))
    assert np.array_equal(own.albedo, scene.albedo[scene.material_of])


def test_settings():
    scene = room().with_settings(bins="concentric:8", precision="f64", solver="fixed-point", tolerance=1e-6)
    settings = scene.settings
    assert settings["bins"] == "concentric:8" and settings["solver"] == "fixed-point"
    assert settings["precision"] == "f64" and settings["tolerance"] == 1e-6
    assert settings["backend"] == "auto"


def test_resolved():
    scene = antirad.Scene.load(SCENES / "cornell_boxes.toml")
    resolved = scene.resolved()
    assert [decision[0] for decision in resolved.decisions][:3] == ["mesh", "visibility", "lamps"]
    assert (
        resolved.scene.settings["visibility"] == "explicit" and resolved.scene.settings["lamps"] == "sampled"
    )
    count = len(scene.triangles)
    assert len(resolved.scene.triangles) > count and len(resolved.parents) == len(resolved.scene.triangles)
    # Parts inside of others are left out, and count as dark.
    ones = resolved.on_given(np.ones((len(resolved.parents), 3)))
    assert ones.shape == (count, 3) and ones.max() <= 1 + 1e-9 and ones.mean() > 0.9
    assert len(scene.resolved(cut=False).scene.triangles) == count


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: antirad.Scene.load("gone.toml"), antirad.SceneError, "gone.toml: cannot be read"),
        (lambda: room().replace(albedo=np.ones((3, 3))), antirad.SceneError, "must be below 1|below 1"),
        (
            lambda: room().replace(albedo=np.ones((2, 3))),
            ValueError,
            r"albedo has the shape \(2, 3\); it must be",
        ),
        (lambda: room().replace(vertices=[[0, 0, 0]]), ValueError, r"vertices has the shape \(1, 3\)"),
        (
            lambda: room().replace(power=[-1.0, 0, 0], specular=np.full((3, 3), 0.1)),
            antirad.SceneError,
            "power",
        ),
        (lambda: room().camera("side"), ValueError, 'there is no camera "side"; the scene has main'),
        (lambda: room().with_settings(solver="magic"), ValueError, "solver: unknown variant `magic`"),
        (lambda: room().with_settings(bins="9"), ValueError, "expected THETAxPHI"),
        (lambda: antirad.Camera((0, 0, 0), (0, 0, 0)), antirad.SceneError, "position and target are both"),
        (lambda: antirad.Material("m", normalization="odd"), ValueError, "unknown variant `odd`"),
        (
            lambda: antirad.Scene.from_arrays(np.zeros((3, 3)), [[0, 1, 7]], [antirad.Material("m")]),
            antirad.SceneError,
            "vertex index 7 is out of range; there are 3",
        ),
        (
            lambda: antirad.Scene.from_arrays(np.zeros((3, 3)), [[0, 1, -1]], [antirad.Material("m")]),
            antirad.SceneError,
            "out of range",
        ),
        (
            lambda: antirad.Scene.from_arrays(np.eye(3), [[0.5, 1, 2]], [antirad.Material("m")]),
            TypeError,
            "same_kind",
        ),
        (
            lambda: antirad.Scene.from_arrays(np.full((3, 3), np.nan), [[0, 1, 2]], [antirad.Material("m")]),
            antirad.SceneError,
            "coordinates must be finite",
        ),
        (lambda: room().place_of(10**6), ValueError, "there is no triangle 1000000"),
    ],
)
def test_bad_input_is_refused_in_words(make, error, words):
    with pytest.raises(error, match=words):
        make()


def test_every_error_is_an_antirad_error():
    kinds = [antirad.SceneError, antirad.PlanError, antirad.DeviceError, antirad.SolveError]
    assert all(issubclass(kind, antirad.Error) for kind in [*kinds, antirad.PictureError, antirad.FitError])


def test_check_and_refine():
    scene = antirad.Scene.load(SCENES / "cornell_boxes.toml").with_settings(visibility="implicit")
    (warning,) = [w for w in antirad.check(scene) if w.kind == "coarse blockers"]
    assert len(warning.triangles) == 66 and warning.worst[0]["triangle"] == warning.triangles[0]
    assert "remedy" in str(warning) and 0 < warning.effect < 0.05
    refined = antirad.refine(scene, levels=1)
    assert len(refined.scene.triangles) == len(refined.parents) > 3092
    assert refined.scene.areas.sum() == pytest.approx(scene.areas.sum())
    with pytest.raises(antirad.PlanError, match="already"):
        antirad.refine(scene, max_triangles=100)


def test_pictures_are_written_and_read(tmp_path):
    picture = np.random.default_rng(1).random((5, 7, 3)).astype(np.float32)
    antirad.write_picture(tmp_path / "a.exr", picture)
    assert np.array_equal(antirad.read_picture(tmp_path / "a.exr"), picture)
    antirad.write_picture(tmp_path / "a.png", picture, exposure=0)
    assert antirad.read_picture(tmp_path / "a.png") == pytest.approx(picture, abs=0.01)
    with pytest.raises(ValueError, match=r"ends in \.exr or \.png"):
        antirad.write_picture(tmp_path / "a.jpg", picture)
    with pytest.raises(antirad.PictureError, match=r"b\.png: cannot be read"):
        antirad.read_picture(tmp_path / "b.png")


def test_a_sun_lights_a_floor():
    black = antirad.Material("black")
    floor = antirad.Scene.from_arrays([[0, 0, 0], [0, 0, 1], [1, 0, 0]], [[0, 1, 2]], [black])
    lit = floor.with_sun([0, -2, 0], [1, 2, 3], angular_diameter=1)
    assert lit.suns == [((0, -2, 0), (1, 2, 3), 1)]
    engine = antirad.Engine(lit, gradients=["emission"])
    solution = engine.solve()
    np.testing.assert_allclose(solution.irradiance[0], [1, 2, 3], rtol=1e-6)
    gradients = engine.backward(solution, irradiance=np.ones((1, 3))).by_material(lit)
    np.testing.assert_allclose(gradients.suns, [[1, 1, 1]], rtol=1e-6)
    with pytest.raises(antirad.SceneError, match="irradiance is -1"):
        floor.with_sun([0, -1, 0], -1)


def test_a_sky_lights_a_floor():
    black = antirad.Material("black")
    floor = antirad.Scene.from_arrays([[0, 0, 0], [0, 0, 1], [1, 0, 0]], [[0, 1, 2]], [black])
    lit = floor.with_sky([1, 2, 3])
    assert lit.triangles.shape == (13, 3)
    irradiance = antirad.Engine(lit).solve().irradiance
    np.testing.assert_allclose(irradiance[0], np.pi * np.array([1, 2, 3]), rtol=1e-6)
    with pytest.raises(ValueError, match="radiance of -1"):
        floor.with_sky(-1)
