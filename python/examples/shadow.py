"""Find the place of a box that no picture shows, from its shadow on the floor, with torch.optim.

    python shadow.py                 # seconds

Writes shadow.png: the given picture, the one at the start, and the recovered one.
"""

import argparse
from pathlib import Path

import numpy as np
import torch

import antirad
import antirad.torch

SCENES = Path(__file__).resolve().parents[2] / "scenes"

arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
arguments.add_argument("--quick", action="store_true", help="fewer pixels, fewer steps")
arguments.add_argument("--output", type=Path, default=Path("out/python"))
arguments = arguments.parse_args()

truth = antirad.Scene.load(SCENES / "fits" / "box.toml")
width, height = (32, 24) if arguments.quick else (192, 144)
view = truth.camera("shadow").replace(width=width, height=height)
truth = truth.replace(cameras=[view])

# The vertices of the box; all others stay.
(triangles,) = [of for name, of in truth.meshes if name == "box"]
of_box = np.unique(truth.triangles[list(triangles)])
weight = torch.zeros(len(truth.vertices), 1, dtype=torch.float64)
weight[of_box] = 1
place = torch.tensor(truth.vertices)


def render(offset):
    return antirad.torch.render(truth, vertices=place + weight * offset)


target = render(torch.zeros(3, dtype=torch.float64))
start = torch.tensor([0.15, -0.1, 0.12], dtype=torch.float64)
# In units of the box, so that steps are of order one.
unknown = (start / 0.8).requires_grad_()
optimiser = torch.optim.LBFGS(
    [unknown],
    lr=0.5,
    max_iter=15 if arguments.quick else 30,
    line_search_fn="strong_wolfe",
    tolerance_change=1e-12,
)
steps = []


def closure():
    optimiser.zero_grad()
    value = ((render(0.8 * unknown) - target) ** 2).mean() / (target**2).mean()
    value.backward()
    steps.append(value.item())
    off = 1000 * (0.8 * unknown).norm().item()
    print(f"evaluation {len(steps):3}: loss {value.item():.3e}, the box is {off:.2f} mm off", flush=True)
    return value


optimiser.step(closure)

with torch.no_grad():
    pictures = [target, render(start), render(0.8 * unknown)]
arguments.output.mkdir(parents=True, exist_ok=True)
antirad.write_picture(arguments.output / "shadow.png", torch.cat(pictures, dim=1))

off = (0.8 * unknown).norm().item()
print(f"the box started {start.norm().item() * 1000:.0f} mm off and ends {off * 1000:.2f} mm off")
if not off <= 0.01:
    raise SystemExit("the box was not found")
