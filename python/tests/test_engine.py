import threading
import time

import numpy as np
import pytest
from rooms import exact, room

import antirad


def test_planned_bytes_are_labelled_and_add_up():
    plan = antirad.plan(room(), gradients=["albedo"])
    assert sum(plan.bytes.values()) == plan.total_bytes <= plan.memory_budget
    assert plan.report()["memory_total"] == plan.total_bytes
    assert "memory" in str(plan)
    with pytest.raises(antirad.PlanError, match="a memory budget of 1000 bytes is too small"):
        antirad.plan(room(), memory_budget=1000)
    with pytest.raises(ValueError, match='there is no derivative by "colour"'):
        antirad.plan(room(), gradients=["colour"])


@pytest.mark.parametrize("kind", ["cpu", "vulkan"])
def test_a_backend_is_opened(kind):
    backend = antirad.Backend(kind, memory_budget=1 << 28)
    assert backend.kind == kind and backend.device in repr(backend)
    assert backend.threads >= 1 and backend.driver and backend.memory["budget"] == 1 << 28
    assert (backend.info is None) == (kind == "cpu") and backend.validation_messages == []
    before = backend.memory["in_use"]
    engine = antirad.Engine(room(), backend=backend)
    assert engine.backend.kind == kind
    # What is planned is what is taken, but for vectors and staging, which come with the first solve.
    assert before < backend.memory["in_use"] <= before + engine.plan.total_bytes


def test_a_device_is_listed_and_named():
    name = antirad.Backend("vulkan").device
    assert name in [info["name"] for info in antirad.devices()]
    # A device that is named is one of Vulkan.
    assert antirad.Backend(device=name).kind == "vulkan"
    with pytest.raises(antirad.DeviceError, match="no such thing"):
        antirad.Backend(device="no such thing")
    with pytest.raises(ValueError, match="no backend: auto, vulkan or cpu"):
        antirad.Backend("gpu")


def test_backends_agree():
    scene = room()
    cpu, vulkan = (
        antirad.Engine(scene, backend=antirad.Backend(kind)).solve().irradiance for kind in ("cpu", "vulkan")
    )
    assert np.linalg.norm(cpu - vulkan) <= 1e-3 * np.linalg.norm(cpu)


def test_plans_are_for_a_backend():
    staging = {kind: antirad.plan(room(), backend=antirad.Backend(kind)).bytes for kind in ("cpu", "vulkan")}
    assert "staging" in staging["vulkan"] and "staging" not in staging["cpu"]


def test_light_is_solved_for():
    scene = room()
    engine = antirad.Engine(scene)
    calls = []
    solution = engine.solve(progress=lambda *call: calls.append(call))
    assert solution.irradiance.shape == solution.radiosity.shape == (len(scene.triangles), 3)
    assert not solution.irradiance.flags.writeable
    passes, residual, share = calls[-1]
    assert passes == solution.passes and residual == solution.residuals[-1] <= 1e-4 and 0.0 <= share <= 1.0
    # Energy: 0.36 m² of lamp.
    assert solution.energy["emitted"] == pytest.approx(0.36 * np.pi * np.array([3.0, 2.5, 2.0]))
    again = engine.solve()
    assert np.array_equal(again.irradiance, solution.irradiance), "same input, same bytes"
    assert engine.solve(start=solution).passes < solution.passes


def test_an_array_of_a_solution_outlives_it():
    engine = antirad.Engine(room())
    irradiance = engine.solve().irradiance
    kept = irradiance.copy()
    engine.solve()
    assert np.array_equal(irradiance, kept)


def test_a_picture_is_a_mean_of_face_colours():
    scene = room(width=16, height=12)
    engine = antirad.Engine(scene)
    solution = engine.solve()
    picture = engine.render(solution, supersample=4, shading="face")
    assert picture.shape == (12, 16, 3) and picture.dtype == np.float32
    colours = engine.face_colours(solution, scene.camera().position)
    assert colours.min() - 1e-6 <= picture.min() and picture.max() <= colours.max() + 1e-6
    with pytest.raises(antirad.PictureError, match="supersample = 3 must be a power of two"):
        engine.render(solution, supersample=3)


def test_materials_are_replaced():
    scene = room()
    engine = antirad.Engine(scene)
    bright = engine.solve()
    engine.set_materials(scene.replace(emission=2 * scene.emission))
    assert engine.solve().irradiance == pytest.approx(2 * bright.irradiance, rel=1e-4)
    with pytest.raises(antirad.Error, match="materials have changed"):
        engine.face_colours(bright, (0, 0, 0))


def test_a_solve_that_does_not_converge_is_an_error():
    engine = antirad.Engine(room())
    with pytest.raises(antirad.SolveError, match="no convergence"):
        engine.solve(max_passes=2)
    with pytest.raises(antirad.Error, match="must be above 0 and below 1"):
        engine.solve(tolerance=2.0)


def test_backward_agrees_with_differences():
    scene = exact(room()).with_settings(visibility="implicit")
    engine = antirad.Engine(scene, gradients=["emission", "albedo", "diffuse", "vertices"])
    solution = engine.solve()
    weights = np.random.default_rng(2).random(solution.irradiance.shape)
    by_triangle = engine.backward(solution, irradiance=weights)
    assert by_triangle.power is None and by_triangle.vertices.shape == scene.vertices.shape
    gradients = by_triangle.by_material(scene)

    def loss(changed):
        return (weights * antirad.Engine(changed).solve().irradiance).sum()

    step = 1e-5
    # The light is piecewise smooth in positions, so differences are less accurate there.
    for kind, at, within in [
        ("emission", (2, 1), 1e-7),
        ("albedo", (0, 0), 1e-7),
        ("diffuse", (1,), 1e-7),
        ("vertices", (3, 2), 1e-3),
    ]:
        moved = [getattr(scene, kind) for _ in range(2)]
        moved[0][at] += step
        moved[1][at] -= step
        above, below = (loss(scene.replace(**{kind: values})) for values in moved)
        difference = (above - below) / (2 * step)
        assert getattr(gradients, kind)[at] == pytest.approx(difference, rel=within), kind


def test_backward_refuses_what_was_not_planned():
    engine = antirad.Engine(room())
    solution = engine.solve()
    with pytest.raises(antirad.Error, match="were not planned"):
        engine.backward(solution, irradiance=np.zeros_like(solution.irradiance))
    with pytest.raises(ValueError, match="irradiance has the shape"):
        engine.backward(solution, irradiance=np.zeros((1, 3)))


def test_other_threads_run_during_a_solve():
    engine = antirad.Engine(room(cells=8))
    done, count = threading.Event(), 0

    def work():
        engine.solve(tolerance=1e-6)
        done.set()

    worker = threading.Thread(target=work)
    worker.start()
    while not done.wait(0.001):
        count += 1
    worker.join()
    assert count > 3


def test_an_exception_in_a_callback_ends_the_work():
    class EnoughError(Exception):
        pass

    def stop(*_):
        raise EnoughError

    engine = antirad.Engine(room())
    with pytest.raises(EnoughError):
        engine.solve(progress=stop)
    assert engine.solve().passes > 2, "the engine remains usable"


def test_ambiguity_of_one_view():
    scene = room()
    found = antirad.ambiguity(scene)
    assert found.seen.shape == (len(scene.triangles),) and found.seen.dtype == bool
    assert len(found.unseen) == len(found.least) == len(found.most) > 0
    assert not found.seen[found.unseen].any()
    assert (found.least <= scene.emission[scene.material_of][found.unseen] + 1e-6).all()
    seen = found.determination[found.seen].mean()
    assert found.determination[found.unseen].mean() < seen
    calls = []
    antirad.ambiguity(scene, progress=lambda *call: calls.append(call))
    assert calls[-1] == (len(found.unseen), len(found.unseen))


def test_time_is_not_lost_to_waiting():
    """A short call returns as soon as it is done, not at the next look for signals."""
    engine = antirad.Engine(room())
    solution = engine.solve()
    start = time.perf_counter()
    for _ in range(20):
        engine.face_colours(solution, (0, 0, 0))
    assert time.perf_counter() - start < 20 * 0.04
