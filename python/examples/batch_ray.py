"""Find a displaced box from many starting points at once, with Ray, on one machine or on many.

    python batch_ray.py              # a minute
    ray job submit -- python batch_ray.py    # on the machines of a Ray cluster that have antirad

A fit finds the nearest minimum. Which start is near enough is unknown beforehand, so each is a task of its
own, and the lowest loss wins. Ray hands out the tasks and repeats those whose machine is lost.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import ray

import antirad

SCENES = Path(__file__).resolve().parents[2] / "scenes"

arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
arguments.add_argument("--quick", action="store_true", help="fewer pixels, fewer starts")
arguments.add_argument("--output", type=Path, default=Path("out/python"))
arguments = arguments.parse_args()

width, height = (32, 24) if arguments.quick else (96, 72)
starts = np.random.default_rng(1).uniform(-0.3, 0.3, (3 if arguments.quick else 16, 3))
# The truth, with all cameras but the one that sees the shadow alone.
truth = antirad.Scene.load(SCENES / "fits" / "box.toml")
views = [truth.camera(name).replace(width=width, height=height) for name in ("one", "other")]


@ray.remote(num_cpus=1, max_retries=3)
def fit(start, pictures):
    """Fit from one start. The scene is read where the task runs."""
    scene = antirad.Scene.load(SCENES / "fits" / "box.toml")
    cameras = [scene.camera(name).replace(width=width, height=height) for name in ("one", "other")]
    result = antirad.fit(
        scene.replace(cameras=cameras),
        [antirad.Target(camera, picture) for camera, picture in zip(cameras, pictures, strict=True)],
        [antirad.Fit("position", meshes=["box"], motion="translation", initial=list(start))],
        supersample=8,
        relative_decrease=1e-3,
        iterations=8 if arguments.quick else 30,
    )
    (found,) = (value["value"] for value in result.recovered if value["quantity"] == "translation")
    return {"start": list(start), "found": list(found), "loss": result.loss, "seconds": result.seconds}


ray.init(include_dashboard=False, log_to_driver=False)
engine = antirad.Engine(truth.replace(cameras=views))
solution = engine.solve()
# One copy for all tasks of a machine.
pictures = ray.put([engine.render(solution, camera, supersample=8) for camera in views])
waiting = [fit.remote(start, pictures) for start in starts]
results = []
while waiting:
    done, waiting = ray.wait(waiting)
    results += ray.get(done)
    off = 1000 * np.linalg.norm(results[-1]["found"])
    print(f"{len(results)} of {len(starts)}: loss {results[-1]['loss']:.3e}, {off:.2f} mm off", flush=True)
ray.shutdown()

results.sort(key=lambda result: result["loss"])
best = 1000 * np.linalg.norm(results[0]["found"])
print(f"the best is {best:.3f} mm off, from a start {1000 * np.linalg.norm(results[0]['start']):.0f} mm off")
arguments.output.mkdir(parents=True, exist_ok=True)
(arguments.output / "batch_ray.json").write_text(json.dumps(results, indent=2) + "\n")
assert best < (100 if arguments.quick else 2)
