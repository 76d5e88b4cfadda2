"""Find the emission of every triangle of a room from two views, and what they leave undetermined.

    python emission.py               # seconds

Writes emission.png: for both views, and for a third one that was not given, the true picture, the recovered
one, and how far the emission of each triangle is determined, from black (not at all) to bright.
"""

import argparse
from pathlib import Path

import numpy as np

import antirad

SCENES = Path(__file__).resolve().parents[2] / "scenes"

arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
arguments.add_argument("--quick", action="store_true", help="fewer pixels, fewer iterations")
arguments.add_argument("--output", type=Path, default=Path("out/python"))
arguments = arguments.parse_args()

scene = antirad.Scene.load(SCENES / "fits" / "room.toml")
width, height = (48, 36) if arguments.quick else (192, 144)
views = [scene.camera(name).replace(width=width, height=height) for name in ("one", "low", "other")]
# The third view is not given: it shows what the others leave open.
scene = scene.replace(cameras=views[:2])
engine = antirad.Engine(scene)
solution = engine.solve()
true_pictures = [engine.render(solution, camera) for camera in views]
given = true_pictures[:2]

# A lamp may be anywhere: each triangle has an emission of its own, none at the start. Of all emissions that
# explain the pictures the regulariser prefers one with little power.
dark = scene.replace(emission=np.zeros_like(scene.emission))
result = antirad.fit(
    dark,
    [antirad.Target(camera, picture) for camera, picture in zip(scene.cameras, given, strict=True)],
    [antirad.Fit("emission", per="triangle", upper=30)],
    regularisers=[antirad.Regulariser.sparsity(1e-4)],
    iterations=20 if arguments.quick else 40,
    progress=lambda record: print(
        f"iteration {record['iteration']:3}: loss {record['loss']:.3e}", flush=True
    ),
)
found = result.scene.emission[result.scene.material_of]
true = scene.emission[scene.material_of]
areas = scene.areas[:, None]
lamp = true.sum(axis=1) > 0
power = (areas * found).sum()
share = (areas * found)[lamp].sum() / power
print(
    f"{100 * share:.1f} % of the light found leaves the lamp, {power / (areas * true).sum():.3f} of its power"
)

# What these pictures cannot tell, whatever the method.
ambiguity = antirad.ambiguity(scene)
unseen, count = len(ambiguity.unseen), len(ambiguity.seen)
print(f"{unseen} of {count} triangles are unseen: the emissions that give the same pictures have {unseen}")
print("dimensions per channel. The unseen triangle that may be brightest:")
most = np.where(np.isfinite(ambiguity.most), ambiguity.most, 0).sum(axis=1)
brightest = ambiguity.unseen[most.argmax()]
place, truth = scene.place_of(brightest), true[brightest].mean()
print(f"  {place}: up to {most.max() / 3:.2f} W/(m² sr), in truth {truth:.2f}")

# Determination as a picture: a scene of black triangles that glow.
glow = np.nan_to_num(ambiguity.determination)[:, None] * [1.0, 0.8, 0.3]
own = scene.per_triangle()
shown = antirad.Engine(own.replace(albedo=np.zeros_like(own.albedo), emission=glow))
light = shown.solve()
engine = antirad.Engine(result.scene)
solution = engine.solve()
rows = []
for camera, picture in zip(views, true_pictures, strict=True):
    bright = 1 / np.quantile(picture, 0.9)
    recovered = engine.render(solution, camera)
    rows.append(np.concatenate([bright * picture, bright * recovered, shown.render(light, camera)], axis=1))
arguments.output.mkdir(parents=True, exist_ok=True)
antirad.write_picture(arguments.output / "emission.png", np.concatenate(rows), exposure=0)

difference = max(
    np.linalg.norm(recovered - picture) / np.linalg.norm(picture)
    for picture, recovered in zip(given, result.pictures, strict=True)
)
print(f"the pictures are explained to {100 * difference:.2f} %")
if not difference <= 0.1:
    raise SystemExit("the pictures are not explained")
