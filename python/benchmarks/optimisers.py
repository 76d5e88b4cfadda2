"""Compare the optimiser of fits with SciPy's L-BFGS-B: evaluations and passes until the loss has fallen.

    pip install scipy
    python optimisers.py --output out/optimisers

Both minimise the same loss of the same pictures from the same start, in unknowns of order one, within bounds.
Writes optimisers.csv, and prints it.
"""

import argparse
import csv
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import antirad

SCENES = Path(__file__).resolve().parents[2] / "scenes"
#: The loss is reported where it has fallen by these factors.
FACTORS = (1e2, 1e4, 1e6)


class Case:
    """A fit: a true scene, where it starts, and what moves."""

    def __init__(self, scene, fits, places, loss="relative-l2", supersample=4):
        """Take (quantity, materials, lowest, highest, start) of each unknown quantity as `places`."""
        self.scene = antirad.Scene.load(SCENES / scene).with_settings(tolerance=1e-5)
        self.fits = fits
        self.places = places
        self.loss = loss
        self.supersample = supersample
        kinds = sorted({place[0] for place in places})
        self.renderer = antirad.Renderer(self.scene, gradients=kinds, supersample=supersample)
        self.targets = self.renderer.pictures()
        self.epsilon = 1.0

    def ours(self):
        """Fit by antirad: losses with the evaluations and passes that they took."""
        cameras = [self.scene.camera(name) for name, _, _ in self.renderer.views]
        targets = [antirad.Target(c, picture) for c, picture in zip(cameras, self.targets, strict=True)]
        result = antirad.fit(
            self.scene,
            targets,
            self.fits,
            loss=self.loss,
            epsilon=self.epsilon,
            iterations=60,
            relative_decrease=0,
            supersample=self.supersample,
            tolerance=1e-5,
        )
        evaluations = np.cumsum([record["evaluations"] for record in result.history])
        passes = np.cumsum([record["passes"] for record in result.history])
        return [(r["loss"], e, p) for r, e, p in zip(result.history, evaluations, passes, strict=True)]

    def scipys(self):
        """Do the same by SciPy."""
        values = {kind: np.array(getattr(self.scene, kind), dtype=float) for kind in ("emission", "albedo")}
        values |= {kind: np.array(getattr(self.scene, kind), dtype=float) for kind in ("specular", "power")}
        names = [material.name for material in self.scene.materials]
        slots, start, bounds, scales = [], [], [], []
        for kind, material, low, high, at in self.places:
            row = names.index(material)
            for slot in [(kind, row)] if kind == "power" else [(kind, row, c) for c in range(3)]:
                slots.append(slot)
                scale = max(1.0, abs(at))
                start.append(at / scale)
                bounds.append((low / scale, None if high is None else high / scale))
                scales.append(scale)
        kinds = sorted({slot[0] for slot in slots})
        seen = []

        def loss(x):
            for slot, unknown, scale in zip(slots, x, scales, strict=True):
                values[slot[0]][slot[1:]] = unknown * scale
            given = {kind: values[kind] for kind in kinds}
            before = self.renderer.passes
            pictures = self.renderer.pictures(**given)
            total, cotangents = 0.0, []
            for picture, target in zip(pictures, self.targets, strict=True):
                weight = 1 / (target**2 + self.epsilon**2) / target.size / len(self.targets)
                total += (weight * (picture - target) ** 2).sum()
                cotangents.append(2 * weight * (picture - target))
            gradients = self.renderer.pull_back(cotangents, **given)
            by = {kind: getattr(gradients, kind) for kind in kinds}
            gradient = [by[slot[0]][slot[1:]] * scale for slot, scale in zip(slots, scales, strict=True)]
            passes = seen[-1][2] if seen else 0
            best = min(total, seen[-1][0]) if seen else total
            seen.append((best, len(seen) + 1, passes + self.renderer.passes - before))
            return total, np.array(gradient)

        options = {"ftol": 0, "gtol": 0, "maxfun": 45, "maxiter": 45, "maxcor": 20}
        minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        return seen


def cases():
    """Yield the fits that are compared."""
    yield (
        "cornell",
        Case(
            "cornell_boxes.toml",
            [
                antirad.Fit("albedo", materials=["red", "green"], initial=0.5),
                antirad.Fit("emission", materials=["light"], initial=5),
            ],
            [
                ("albedo", "red", 0, 0.98, 0.5),
                ("albedo", "green", 0, 0.98, 0.5),
                ("emission", "light", 0, None, 5),
            ],
        ),
    )
    yield (
        "glossy",
        Case(
            "fits/glossy.toml",
            [
                antirad.Fit("specular", materials=["gloss", "satin"], initial=0.1),
                antirad.Fit("power", materials=["gloss", "satin"], initial=15),
            ],
            [
                ("specular", "gloss", 0, 0.4, 0.1),
                ("specular", "satin", 0, 0.4, 0.1),
                ("power", "gloss", 1, 1000, 15),
                ("power", "satin", 1, 1000, 15),
            ],
        ),
    )


def taken(steps, factor):
    """Find evaluations and passes until the loss had fallen by a factor; nothing if it never did."""
    reached = [step for step in steps if step[0] * factor <= steps[0][0]]
    return reached[0][1:] if reached else ("", "")


def main():
    """Run all cases."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("out/optimisers"))
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    rows = [["case", "loss fell by", "antirad evaluations", "passes", "SciPy evaluations", "passes"]]
    for name, case in cases():
        ours, scipys = case.ours(), case.scipys()
        rows += [[name, f"{factor:g}", *taken(ours, factor), *taken(scipys, factor)] for factor in FACTORS]
    with (arguments.output / "optimisers.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    csv.writer(sys.stdout).writerows(rows)


if __name__ == "__main__":
    main()
