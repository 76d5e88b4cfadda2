"""Learn the albedo of a room as a small neural network over positions, from pictures, with torch.optim.

    python network.py                # a minute; --quick: seconds

Writes network.png: the given pictures, those at the start, and those of the network.
"""

import argparse
from pathlib import Path

import torch

import antirad
import antirad.torch

SCENES = Path(__file__).resolve().parents[2] / "scenes"

arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
arguments.add_argument("--quick", action="store_true", help="fewer pixels, fewer steps")
arguments.add_argument("--output", type=Path, default=Path("out/python"))
arguments = arguments.parse_args()

torch.manual_seed(1)
side, steps = (32, 40) if arguments.quick else (96, 150)
room = antirad.Scene.load(SCENES / "closed_box.toml").with_settings(bins="6x9", tolerance=1e-4)
front = room.camera().replace(width=side, height=side)
back = front.replace(position=(0.5, 0.5, 0.97), target=(0.5, 0.5, 0), name="back")
room = room.replace(cameras=[front, back]).per_triangle()

# Centroids, scaled to about -1 to 1.
place = 2 * torch.tensor(room.vertices[room.triangles]).mean(dim=1).float() - 1
# By area, of what is no lamp.
weight = torch.tensor(room.areas * (room.emission.max(axis=1) == 0)).float()
# What is to be found: walls whose colour changes along them.
wave = torch.sin(2 * place @ torch.tensor([[1.0, 0.4, 0], [0, 1, 0.7], [0.5, 0, 1]]))
truth = 0.45 + 0.25 * wave
with torch.no_grad():
    targets = antirad.torch.render(room, albedo=truth)

network = torch.nn.Sequential(
    torch.nn.Linear(3, 32), torch.nn.Tanh(), torch.nn.Linear(32, 32), torch.nn.Tanh(), torch.nn.Linear(32, 3)
)
optimiser = torch.optim.Adam(network.parameters(), lr=0.03)


def off(albedo):
    return ((weight[:, None] * (albedo - truth) ** 2).sum() / (3 * weight.sum())).sqrt().item()


for step in range(steps):
    albedo = 0.95 * torch.sigmoid(network(place))
    pictures = antirad.torch.render(room, albedo=albedo)
    loss = sum(((a - b) ** 2 / (b**2 + 1e-4)).mean() for a, b in zip(pictures, targets, strict=True))
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    if step == 0:
        first, start = pictures, off(albedo)
    print(f"step {step + 1:3}: loss {loss.item():.3e}, albedo {off(albedo):.3f} rms", flush=True)

arguments.output.mkdir(parents=True, exist_ok=True)
rows = [torch.cat(row, dim=1).detach() for row in (targets, first, pictures)]
antirad.write_picture(arguments.output / "network.png", torch.cat(rows))
print(f"albedos started {start:.3f} off and end {off(albedo):.3f} off, rms over area")
if not off(albedo) < 0.5 * start:
    raise SystemExit("the albedos were not found")
