"""Rooms with dense blockers, made here, rendered by antirad, timed, and compared with its path tracer.

    scripts/gallery dense                   # all scenes, some 10 min on two cores
    scripts/gallery dense shelf blinds      # these alone
    scripts/gallery dense --make            # writes their files, no more

Writes to --output: NAME.toml with its meshes, rendered/NAME, traced/NAME, and dense.md (the table).
"""

import argparse
import json
import random
import resource
import sys
from math import cos, radians, sin
from pathlib import Path

from gallery import ROOT, GalleryError, antirad, compared, header, line, only, write

COLUMNS = ("scene", "triangles", "visibility", "passes", "seconds", "processor seconds", "relMSE", "mean")

#: A room of 3 x 2.5 x 3 m. Where a scene has its own light, the lamp below the ceiling is left out.
ROOM = """
[[mesh]]
name = "room"
shape = { kind = "room", cells = 12 }
material = "wall"
scale = [3, 2.5, 3]

[material.wall]
albedo = 0.7

[material.wood]
albedo = [0.5, 0.35, 0.2]

[material.cloth]
albedo = [0.25, 0.35, 0.6]

[material.leaf]
albedo = [0.1, 0.4, 0.1]

[material.light]
albedo = 0
emission = [12, 11, 9]

[camera.main]
position = [2.7, 1.5, 2.75]
target = [1.4, 1.0, 1]
fov_x_degrees = 75
width = 160
height = 120
"""
LAMP = """
[[mesh]]
name = "lamp"
shape = { kind = "quad", cells = 1 }
material = "light"
scale = [0.6, 1, 0.6]
rotate_degrees = [180, 0, 0]
translate = [1.2, 2.45, 1.8]
"""


def shape(name, kind, cells, material, scale, at, turned=(0, 0, 0), two_sided=False):
    """Return a mesh of a scene file: a shape, scaled, then turned, then moved."""
    lines = [
        "[[mesh]]",
        f'name = "{name}"',
        f'shape = {{ kind = "{kind}", cells = {cells} }}',
        f'material = "{material}"',
        *(
            f"{key} = {[round(x, 6) for x in value]}"
            for key, value in (("scale", scale), ("rotate_degrees", turned), ("translate", at))
        ),
    ]
    return "\n".join(lines + ["two_sided = true"] * two_sided) + "\n"


def turn(draw):
    return [draw.uniform(0, 360) for _ in range(3)]


def box(name, material, size, at, cells=2, turned=(0, 0, 0)):
    return shape(name, "box", cells, material, size, at, turned)


def pile(_):
    """Place ninety cubes with gaps of a hundredth of their size."""
    pitch = 0.202
    cubes = [(x, y, z) for y in range(5) for x in range(6) for z in range(3)]
    return LAMP + "".join(
        box("cube", "wood", [0.2] * 3, [0.6 + pitch * x, 0.002 + pitch * y, 0.8 + pitch * z])
        for x, y, z in cubes
    )


def rods(_):
    """Place 14 x 14 rods of 5 cm, 16 cm apart."""
    return LAMP + "".join(
        box("rod", "wood", [0.05, 1.2, 0.05], [0.3 + 0.16 * x, 0.001, 0.3 + 0.16 * z], 1)
        for x in range(14)
        for z in range(14)
    )


def shelf(draw):
    """Place a shelf of five boards with a hundred books."""
    text = LAMP
    for level in range(5):
        y = 0.15 + 0.38 * level
        text += box("board", "wood", [2.0, 0.02, 0.25], [0.5, y, 0.03], 4)
        x = 0.52
        for _ in range(20):
            size = [draw.uniform(0.03, 0.07), draw.uniform(0.2, 0.32), draw.uniform(0.15, 0.22)]
            text += box("book", draw.choice(["cloth", "wood", "wall"]), size, [x, y + 0.021, 0.04])
            x += size[0] + draw.uniform(0.002, 0.02)
    for side in (0.478, 2.502):
        text += box("side", "wood", [0.02, 1.9, 0.25], [side, 0.002, 0.03], 4)
    return text


def blinds(_):
    """Place sixty slats of two sides before a bright window."""
    window = shape("window", "quad", 1, "light", [1.6, 1, 1.8], [0.7, 0.4, 0.02], [90, 0, 0])
    return window + "".join(
        shape("slat", "quad", 1, "wall", [1.7, 1, 0.035], [0.65, 0.4 + 0.03 * k, 0.12], [40, 0, 0], True)
        for k in range(60)
    )


def chairs(_):
    """Place a table and six chairs of rods."""
    text = LAMP + box("table", "wood", [1.4, 0.03, 0.8], [0.8, 0.72, 1.1], 6)
    legs = [(x, z) for x in (0.85, 2.1) for z in (1.15, 1.8)]
    text += "".join(box("leg", "wood", [0.05, 0.719, 0.05], [x, 0.001, z], 2) for x, z in legs)
    for x in (0.85, 1.3, 1.75):
        for z, back in ((0.75, 0.75), (1.85, 2.22)):
            text += box("seat", "cloth", [0.4, 0.03, 0.4], [x, 0.42, z], 2)
            text += "".join(
                box("leg", "wood", [0.03, 0.419, 0.03], [x + a, 0.001, z + b], 1)
                for a in (0.01, 0.36)
                for b in (0.01, 0.36)
            )
            text += "".join(
                box("spindle", "wood", [0.015, 0.5, 0.015], [x + 0.02 + 0.06 * k, 0.451, back], 1)
                for k in range(7)
            )
            text += box("rail", "wood", [0.4, 0.04, 0.03], [x, 0.952, back - 0.008], 2)
    return text


def chandelier(draw):
    """Place twenty-four small lamps on arms, above sixty drops."""
    text = box("stem", "wood", [0.03, 0.6, 0.03], [1.485, 1.85, 1.485])
    for k in range(24):
        ring, height = (0.35, 1.75) if k % 2 else (0.55, 1.85)
        angle = radians(15 * k)
        x, z = 1.5 + ring * cos(angle), 1.5 - ring * sin(angle)
        text += box("arm", "wood", [ring, 0.012, 0.012], [1.5, height, 1.5], 1, [0, 15 * k, 0])
        text += box("bulb", "bulb", [0.03, 0.04, 0.03], [x - 0.015, height + 0.03, z - 0.015], 1)
    for _ in range(60):
        at = [draw.uniform(1.05, 1.95), draw.uniform(1.55, 1.72), draw.uniform(1.05, 1.95)]
        text += box("drop", "wall", [0.03, 0.05, 0.03], at, 1, turn(draw))
    return text + "\n[material.bulb]\nalbedo = 0\nemission = [120, 110, 90]\n"


def leaves(draw):
    """Place a plant of 1500 leaves of two sides, 10 x 6 cm, in a ball of .7 m."""
    text, leaf = LAMP, 0
    while leaf < 1500:
        at = [draw.uniform(-0.7, 0.7) for _ in range(3)]
        if sum(x * x for x in at) < 0.49:
            place = [1.4 + at[0], 1.0 + at[1], 1.2 + at[2]]
            text += shape("leaf", "quad", 1, "leaf", [0.1, 1, 0.06], place, turn(draw), True)
            leaf += 1
    return text


def soup(_):
    """Place a thousand triangles of two sides anywhere, of up to .3 m, and a bright ball among them."""
    return """
[[mesh]]
name = "ball"
shape = { kind = "icosphere", level = 2 }
material = "light"
scale = 0.15
translate = [1.5, 1.2, 1.5]

[[mesh]]
name = "soup"
path = "soup.obj"
material = "wood"
two_sided = true
"""


def scattered(draw):
    """Return the OBJ of those triangles."""
    corners = []
    for _ in range(1000):
        at = [draw.uniform(0.2, 2.8), draw.uniform(0.2, 2.3), draw.uniform(0.2, 2.8)]
        corners += [[x + draw.uniform(-0.15, 0.15) for x in at] for _ in range(3)]
    faces = [f"f {k} {k + 1} {k + 2}" for k in range(1, len(corners), 3)]
    return "\n".join([*("v {:.6f} {:.6f} {:.6f}".format(*x) for x in corners), *faces]) + "\n"


SCENES = {make.__name__: make for make in (leaves, pile, rods, shelf, blinds, chairs, chandelier, soup)}


def prepare(name, output):
    """Write the files of a scene; return that of the scene. They are the same each time."""
    file = output / f"{name}.toml"
    write(file, f"# {SCENES[name].__doc__}\n{SCENES[name](random.Random(1))}{ROOM}")
    if name == "soup":
        write(output / "soup.obj", scattered(random.Random(1)))
    return file


def processor_seconds():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def row(name, output, samples):
    """Render and trace a scene; return its row of the table."""
    file = prepare(name, output)
    rendered, traced = (output / kind / name for kind in ("rendered", "traced"))
    before = processor_seconds()
    seconds, done, _ = antirad("render", file, "--backend", "cpu", "--output", rendered)
    used = processor_seconds() - before
    print(f"{name}: {seconds:.1f} s, exit code {done.returncode}; tracing", flush=True)
    antirad("trace", file, "--samples", samples, "--output", traced)
    report = json.loads((rendered / "report.json").read_text())
    errors = compared(only(traced, ".exr"), only(rendered, ".exr"))
    return line(
        name if done.returncode == 0 else f"{name}, exit code {done.returncode}",
        str(report["plan"]["triangles"]),
        report["plan"]["transport"].split(",")[0],
        str(report["solve"]["passes"]),
        f"{seconds:.1f}",
        f"{used:.1f}",
        f"{errors['relmse'] - errors['noise_relmse']:.1e}",
        f"{errors['mean']:+.2f} %",
    )


def main():
    parser = argparse.ArgumentParser(
        prog="gallery dense", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"{', '.join(SCENES)} [default: all]")
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "dense")
    parser.add_argument("--make", action="store_true", help="write the scenes' files, no more")
    parser.add_argument("--samples", type=int, default=512, help="samples a pixel of the path tracer")
    options = parser.parse_args()
    unknown = sorted(set(options.scenes) - set(SCENES))
    if unknown:
        parser.error(f"unknown scenes: {', '.join(unknown)}; known are {', '.join(SCENES)}")
    output = options.output.resolve()
    names = options.scenes or list(SCENES)
    if options.make:
        for name in names:
            print(f"written: {prepare(name, output)}")
        return
    table = header(COLUMNS) + "".join(row(name, output, options.samples) for name in names)
    write(output / "dense.md", table)
    print(f"{table}\nwritten to {output}")


if __name__ == "__main__":
    try:
        main()
    except GalleryError as error:
        sys.exit(f"gallery dense: {error}")
    except KeyboardInterrupt:
        sys.exit("gallery dense: interrupted")
