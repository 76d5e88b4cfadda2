import json

import numpy as np
import pytest
from rooms import room

import antirad


def target(scene):
    engine = antirad.Engine(scene.with_settings(tolerance=1e-5))
    return antirad.Target(scene.camera(), engine.render(engine.solve()))


def test_albedo_and_lamp_are_found():
    truth = room()
    start = truth.replace(albedo=[[0.3] * 3, [0.4] * 3, [0.1] * 3], emission=truth.emission * 0.5)
    records = []
    result = antirad.fit(
        start,
        [target(truth)],
        [
            antirad.Fit("albedo", materials=["wall", "paint"]),
            antirad.Fit("emission", materials=["light"], lower=0, upper=20),
        ],
        iterations=100,
        progress=records.append,
    )
    # Rays go where light was when an engine was made: that of the start, or of the truth.
    assert result.scene.albedo[:2] == pytest.approx(truth.albedo[:2], abs=2e-3)
    assert result.scene.emission[2] == pytest.approx(truth.emission[2], rel=2e-3)
    assert result.history == records and records[0]["iteration"] == 0
    assert max(result.loss, records[-1]["loss"]) < 1e-5 * records[0]["loss"]
    assert result.pictures[0].shape == (8, 12, 3)
    assert {found["quantity"] for found in result.recovered} == {"albedo", "emission"}


def test_a_stopped_fit_continues(tmp_path):
    truth = room()
    start = truth.replace(albedo=np.full((3, 3), 0.3))
    arguments = (start, [target(truth)], [antirad.Fit("albedo", materials=["wall"])])

    class EnoughError(Exception):
        pass

    def stop(record):
        if record["iteration"] == 2:
            raise EnoughError

    with pytest.raises(EnoughError):
        antirad.fit(*arguments, checkpoints=tmp_path, progress=stop)
    with pytest.raises(antirad.FitError, match="checkpoint"):
        antirad.fit(*arguments, checkpoints=tmp_path)
    resumed = antirad.fit(*arguments, checkpoints=tmp_path, resume=True)
    straight = antirad.fit(*arguments)
    assert resumed.loss == straight.loss
    assert np.array_equal(resumed.scene.albedo, straight.scene.albedo)


def test_a_job_file_is_run(tmp_path):
    truth = room()
    truth.replace(albedo=np.full((3, 3), 0.3)).save(tmp_path / "room.toml")
    engine = antirad.Engine(truth)
    antirad.write_picture(tmp_path / "photo.exr", engine.render(engine.solve()))
    (tmp_path / "job.toml").write_text(
        'scene = "room.toml"\n[[target]]\npicture = "photo.exr"\ncamera = "main"\n'
        '[[fit]]\nparameter = "albedo"\nmaterials = ["wall"]\n'
    )
    result = antirad.fit_job(tmp_path / "job.toml", iterations=3)
    assert result.history[-1]["iteration"] <= 3 and result.loss < result.history[0]["loss"]
    with pytest.raises(antirad.SceneError, match=r"gone\.toml: cannot be read"):
        antirad.fit_job(tmp_path / "gone.toml")


def test_contradictions_are_refused():
    scene = room()
    picture = np.zeros((8, 12, 3))
    view = antirad.Target(scene.camera(), picture)
    with pytest.raises(antirad.FitError, match="there is nothing to fit"):
        antirad.fit(scene, [view], [])
    with pytest.raises(antirad.FitError, match='"wood"'):
        antirad.fit(scene, [view], [antirad.Fit("albedo", materials=["wood"])])
    with pytest.raises(ValueError, match="quantity: unknown variant `colour`"):
        antirad.Fit("colour")
    with pytest.raises(ValueError, match=r"picture has the shape \(8, 13, 3\); it must be \(8, 12, 3\)"):
        antirad.Target(scene.camera(), np.zeros((8, 13, 3)))
    with pytest.raises(antirad.PictureError, match="column 2, row 1"):
        picture[1, 2] = np.nan
        antirad.Target(scene.camera(), picture)
    regulariser = antirad.Regulariser.smoothness("albedo", 1e-3)
    assert "albedo" in repr(regulariser)


def photographs(folder, scene):
    """A transforms.json and EXR files of a scene from two cameras."""
    cameras = [scene.camera(), scene.camera().replace(position=(-0.4, 0.3, 0.9), name="other")]
    engine = antirad.Engine(scene.with_settings(tolerance=1e-5))
    solution = engine.solve()
    frames = []
    for camera in cameras:
        antirad.write_picture(folder / f"{camera.name}.exr", engine.render(solution, camera))
        frames.append({"file_path": f"{camera.name}.exr", "transform_matrix": pose(camera).tolist()})
    size = {"w": cameras[0].width, "h": cameras[0].height}
    lens = {"camera_angle_x": np.radians(cameras[0].fov_x_degrees), **size}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    return cameras


def test_a_clear_picture_outweighs_a_noisy_one():
    truth = room()
    engine = antirad.Engine(truth)
    picture = engine.render(engine.solve())
    noisy = picture * (1 + 0.9 * np.sign(np.random.default_rng(1).standard_normal(picture.shape)))
    start = truth.replace(albedo=[[0.3] * 3, [0.4] * 3, [0.1] * 3])
    fits = [antirad.Fit("albedo", materials=["wall", "paint"])]

    def error(noises):
        pictures = zip((picture, noisy), noises, strict=True)
        targets = [antirad.Target(truth.camera(), of, noise=noise) for of, noise in pictures]
        found = antirad.fit(start, targets, fits, loss="relative-l2").scene.albedo
        return np.abs(found - truth.albedo)[:2].max()

    assert error([(0, 0.001), (0, 10)]) < 0.1 * error([None, None])
    with pytest.raises(ValueError, match="not both 0"):
        antirad.Target(truth.camera(), picture, noise=(0, 0))


def pose(camera):
    """The columns right, up, backward and position."""
    backward = np.subtract(camera.position, camera.target)
    backward /= np.linalg.norm(backward)
    right = np.cross(camera.up, backward)
    right /= np.linalg.norm(right)
    columns = np.stack([right, np.cross(backward, right), backward, camera.position], axis=1)
    return np.vstack([columns, [0, 0, 0, 1]])


def test_photographs_and_their_cameras_are_read(tmp_path):
    truth = room()
    given = photographs(tmp_path, truth)
    cameras = antirad.load_cameras(tmp_path / "transforms.json")
    assert [camera.name for camera in cameras] == ["main", "other"]
    for camera, wanted in zip(cameras, given, strict=True):
        assert camera.position == pytest.approx(wanted.position)
        assert camera.fov_x_degrees == pytest.approx(wanted.fov_x_degrees)
        assert (camera.width, camera.height) == (12, 8)
    targets = antirad.load_targets(tmp_path / "transforms.json")
    assert targets[1].camera == cameras[1] and targets[1].picture.shape == (8, 12, 3)
    small = antirad.load_targets(tmp_path / "transforms.json", every=2, pixels=24)
    assert [target.picture.shape for target in small] == [(4, 6, 3)]
    assert small[0].picture.mean() == pytest.approx(targets[0].picture.mean())
    start = truth.replace(albedo=[[0.3] * 3, [0.4] * 3, [0.1] * 3])
    fits = [antirad.Fit("albedo", materials=["wall", "paint"])]
    result = antirad.fit(start, targets, fits, loss="relative-l2")
    assert result.scene.albedo[:2] == pytest.approx(truth.albedo[:2], abs=2e-3)
    segments = tmp_path / "{name}.exr"
    with pytest.raises(antirad.PictureError, match=r"main.*floats"):
        antirad.load_targets(tmp_path / "transforms.json", segments=segments)
    with pytest.raises(ValueError, match="not both 0"):
        antirad.load_targets(tmp_path / "transforms.json", noise=(0, 0))
    with pytest.raises(antirad.PictureError, match=r"main.*\.hdr"):
        antirad.load_targets(tmp_path / "transforms.json", suffix=".hdr")
    with pytest.raises(ValueError, match="every"):
        antirad.load_targets(tmp_path / "transforms.json", every=0)
    with pytest.raises(ValueError, match="gamma"):
        antirad.load_targets(tmp_path / "transforms.json", response="gamma", gamma=0)
    with pytest.raises(antirad.PictureError, match="response"):
        antirad.load_targets(tmp_path / "transforms.json", response="fit")
    with pytest.raises(antirad.SceneError, match=r"none\.json"):
        antirad.load_cameras(tmp_path / "none.json")
