"""Recover the coloured walls and the lamp of the Cornell room from a path tracer's picture, with torch.optim.

    python cornell.py                # minutes; --quick: seconds, a coarse room from its own picture

Writes cornell.png: the given picture, the recovered one, and their difference ten times brighter.
"""

import argparse
from pathlib import Path

import numpy as np
import torch

import antirad
import antirad.torch

SCENES = Path(__file__).resolve().parents[2] / "scenes"

arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
arguments.add_argument("--quick", action="store_true")
arguments.add_argument("--output", type=Path, default=Path("out/python"))
arguments = arguments.parse_args()

if arguments.quick:
    scene = antirad.Scene.load(SCENES / "coarse_cornell.toml").with_settings(bins="6x9", tolerance=1e-4)
    target = antirad.torch.render(scene)
else:
    scene = antirad.Scene.load(SCENES / "cornell_boxes.toml").with_settings(tolerance=2e-3)
    target = torch.from_numpy(antirad.read_picture(SCENES / "cornell_boxes.exr")).float()

names = [material.name for material in scene.materials]
walls = [names.index("red"), names.index("green")]
lamp = next(i for i, material in enumerate(scene.materials) if max(material.emission) > 0)

# The unknowns start from grey: sigmoid and exponential keep albedos between 0 and 1, and light positive.
wall_logits = torch.zeros(2, 3, requires_grad=True)
lamp_log = torch.full((3,), float(np.log(5)), requires_grad=True)
albedo = torch.tensor(scene.albedo, dtype=torch.float32)
emission = torch.tensor(scene.emission, dtype=torch.float32)


def values():
    return {
        "albedo": albedo.index_copy(0, torch.tensor(walls), torch.sigmoid(wall_logits)),
        "emission": emission.index_copy(0, torch.tensor([lamp]), torch.exp(lamp_log)[None]),
    }


def loss():
    """Relative squared error, since the lamp is a hundred times as bright as the walls."""
    difference = antirad.torch.render(scene, **values()) - target
    return (difference**2 / (target**2 + 0.01)).mean()


optimiser = torch.optim.LBFGS([wall_logits, lamp_log], max_iter=30, line_search_fn="strong_wolfe")
history = []


def closure():
    optimiser.zero_grad()
    value = loss()
    value.backward()
    history.append(value.item())
    print(f"evaluation {len(history):3}: loss {value.item():.3e}", flush=True)
    return value


optimiser.step(closure)

found = values()
for i in [*walls, lamp]:
    kind = "emission" if i == lamp else "albedo"
    got, true = found[kind][i].detach().numpy(), getattr(scene, kind)[i]
    print(f"{names[i]:>6} {kind:8} {np.round(got, 3)} of {np.round(true, 3)}")

with torch.no_grad():
    picture = antirad.torch.render(scene, **found)
arguments.output.mkdir(parents=True, exist_ok=True)
side_by_side = torch.cat([target, picture, 10 * (picture - target).abs()], dim=1)
antirad.write_picture(arguments.output / "cornell.png", side_by_side, exposure=0.7)

off = (found["albedo"][walls] - albedo[walls]).abs().max().item()
if not off <= 0.05:
    raise SystemExit(f"the walls are off by {off:.3f}")
