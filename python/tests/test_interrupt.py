"""Ctrl-C raises KeyboardInterrupt within a second, whatever runs."""

import os
import signal
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rooms import room

import antirad

SCENES = Path(__file__).resolve().parents[2] / "scenes"


def interrupted(work, after=0.5):
    """Seconds between the signal and the exception that ends the work."""
    sent = []

    def send():
        sent.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(after, send)
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            work()
        return time.perf_counter() - sent[0]
    finally:
        timer.cancel()
        timer.join()


@pytest.fixture(autouse=True)
def handled():
    """Programs that a shell starts in the background ignore the signal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def large():
    return antirad.Scene.load(SCENES / "cornell_boxes_fine.toml").with_settings(tolerance=1e-6)


def again_and_again(work):
    """Work that lasts until it is interrupted, however fast the machine."""
    while True:
        work()


def test_a_solve(large):
    engine = antirad.Engine(large)
    assert interrupted(lambda: again_and_again(engine.solve)) < 1
    # The engine was handed back in time, and works.
    reporting = partial(engine.solve, progress=lambda *_: None)
    assert interrupted(lambda: again_and_again(reporting)) < 1


def test_planning_and_refining(large):
    def work():
        antirad.refine(large, max_triangles=60_000)

    assert interrupted(lambda: again_and_again(work)) < 1


def test_a_fit(large):
    camera = large.camera().replace(width=32, height=32)
    target = antirad.Target(camera, np.full((32, 32, 3), 0.2))
    assert interrupted(lambda: antirad.fit(large, [target], [antirad.Fit("albedo")]), after=1.5) < 1


def test_derivatives(large):
    scene = large.replace(cameras=[large.camera().replace(width=64, height=64)])
    renderer = antirad.Renderer(scene, gradients=["vertices"])

    def work():
        renderer.pull_back([np.ones((64, 64, 3))], vertices=scene.vertices)

    assert interrupted(lambda: again_and_again(work), after=1.5) < 1


def test_nothing_is_interrupted_later():
    engine = antirad.Engine(room())
    assert engine.solve().passes > 0
