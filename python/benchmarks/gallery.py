"""Scenes of others, rendered by antirad, timed, and compared with its path tracer.

    scripts/gallery                  # all scenes
    scripts/gallery veach_mis spot   # these alone
    scripts/gallery --fetch          # fetch and make their meshes, no more
    scripts/gallery --docs           # all, and put tables and pictures into docs

Meshes and pictures of packages go into out/gallery/fetched. Writes to --output: NAME/ (what antirad wrote),
NAME.png (rendered, traced, their difference), NAME.json, and gallery.md (the tables).
"""

import argparse
import hashlib
import http.client
import io
import json
import lzma
import os
import re
import subprocess
import sys
import tarfile
import time
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "scenes" / "gallery"
#: Seconds without a byte after which a server is given up.
SILENCE = 60
#: Seconds after which a render with a target error is given up.
PATIENCE = 100
#: The difference of displayed values is shown this many times.
FACTOR = 5
MARKS = ("<!-- scripts/gallery -->", "<!-- end of scripts/gallery -->")
COLUMNS = (
    "scene",
    "source",
    "licence",
    "triangles",
    "render",
    "passes",
    "trace, samples",
    "noise",
    "error",
    "relMSE (noise)",
    "mean radiance",
)
TARGET_COLUMNS = ("scene", "target", "triangles", "render", "error", "relMSE", "mean radiance")


class GalleryError(Exception):
    """Something that the user can do something about."""


@dataclass(frozen=True)
class Package:
    """An archive in a registry of packages, and what is taken out of it."""

    name: str
    urls: tuple[str, ...]
    sha256: str
    #: Members, with the name that each gets in `fetched`.
    members: dict[str, str]


@dataclass(frozen=True)
class Scene:
    """A scene of the gallery."""

    file: str
    source: str
    licence: str
    #: Stops, of all pictures of the scene.
    exposure: float
    samples: int
    packages: tuple[Package, ...] = ()

    @property
    def name(self):
        return Path(self.file).stem


MODELS = "usr/share/assimp/models/OBJ"
POOL = "pool/main/a/assimp/assimp-testmodels_5.2.5~ds0-1_all.deb"
STUDIO = Package(
    "@pmndrs/assets 1.7.0 of npm",
    ("https://registry.npmjs.org/@pmndrs/assets/-/assets-1.7.0.tgz",),
    "152bd218a3390703f184f0c6ce16e73c8f0a87f32d38530d418a09d33d8208dc",
    {"package/hdri/studio.exr.js": "studio.exr"},
)
SPOT = Package(
    "robust_laplacian 1.1.0 of PyPI",
    (
        "https://files.pythonhosted.org/packages/3e/70/"
        "c33cbba6c85563318719d589af115754e82c5fbdd1df518e1ca42dc7edac/robust_laplacian-1.1.0.tar.gz",
    ),
    "1db9eeb1a7aa340c3da902b125d2f58c7138feda206a72c2402dd25e702290d2",
    {"robust_laplacian-1.1.0/deps/geometry-central/test/assets/spot.ply": "spot.ply"},
)
SPIDER = Package(
    "assimp-testmodels 5.2.5~ds0-1 of Debian 12",
    (
        f"https://deb.debian.org/debian/{POOL}",
        f"https://snapshot.debian.org/archive/debian/20230701T000000Z/{POOL}",
    ),
    "526f326186000cd6f631ea806128548a7d3d391abd8149fddc5c4c8513e80b8a",
    {
        f"{MODELS}/{file}": f"spider/{file}"
        for file in (
            "spider.obj",
            "spider.mtl",
            "SpiderTex.jpg",
            "drkwood2.jpg",
            "engineflare1.jpg",
            "wal67ar_small.jpg",
            "wal69ar_small.jpg",
        )
    },
)

GALLERY = (
    Scene("cornell_box.toml", "Cornell University, measured", "published numbers", 0.3, 256),
    Scene(
        "teapot.toml",
        f"M. Newell, published; sky: Poly Haven, {STUDIO.name}",
        "published numbers; sky CC0",
        -2.0,
        256,
        (STUDIO,),
    ),
    Scene("veach_mis.xml", "E. Veach, S. Marschner, published", "published numbers", 0.0, 256),
    Scene("spot.toml", f"K. Crane, {SPOT.name}", "CC0", 0.0, 256, (SPOT,)),
    Scene("spider.toml", SPIDER.name, "3-clause BSD", -0.3, 256, (SPIDER,)),
)


def write(path, content):
    """Write a file at once, or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        part.write_bytes(content if isinstance(content, bytes) else content.encode())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def download(package):
    """Return the bytes of a package, from the first address that has them."""
    reasons = []
    for url in package.urls:
        print(f"fetching {package.name}: {url}", flush=True)
        try:
            with urllib.request.urlopen(url, timeout=SILENCE) as answer:
                content = answer.read()
        except (OSError, urllib.error.URLError, http.client.HTTPException) as error:
            reasons.append(f"{url}: {error}")
            continue
        digest = hashlib.sha256(content).hexdigest()
        if digest == package.sha256:
            return content
        reasons.append(f"{url}: its SHA-256 is {digest}, not {package.sha256}")
    raise GalleryError(
        f"fetching {package.name} failed: {'; '.join(reasons)}. Without a network, name the scenes that need "
        "none, cornell_box and veach_mis, or copy out/gallery/fetched from another machine"
    )


def data_of_deb(content):
    """Return the tar of files in a Debian package."""
    if not content.startswith(b"!<arch>\n"):
        raise GalleryError("a Debian package is no archive of ar")
    at = 8
    while at + 60 <= len(content):
        name, size = content[at : at + 16].decode().strip(), int(content[at + 48 : at + 58])
        if name.startswith("data.tar.xz"):
            return lzma.decompress(content[at + 60 : at + 60 + size])
        at += 60 + size + size % 2
    raise GalleryError("a Debian package has no data.tar.xz")


def fetch(package, folder):
    """Take the members of a package into a folder, unless they are there."""
    if all((folder / name).exists() for name in package.members.values()):
        return
    content = download(package)
    if package.urls[0].endswith(".deb"):
        content = data_of_deb(content)
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        found = {member.name.removeprefix("./"): member for member in archive if member.isfile()}
        for path, name in package.members.items():
            if path not in found:
                raise GalleryError(f"{package.name} has no file {path}")
            write(folder / name, unwrapped(path, archive.extractfile(found[path]).read()))


def unwrapped(path, content):
    """Return what a JavaScript module of a data URL holds; other files are what they are."""
    if not path.endswith(".js"):
        return content
    url = re.search(rb"data:[^,']*,[A-Za-z0-9+/=]+", content)
    if url is None:
        raise GalleryError(f"{path} has no data URL")
    with urllib.request.urlopen(url[0].decode()) as answer:
        return answer.read()


def patches(path):
    """Return control points of Bézier patches, (n, 4, 4, 3), mirror images included, all turned alike."""
    points, result, mirrors = [], [], []
    signs = {"x": (-1, 1, 1), "z": (1, 1, -1), "xz": (-1, 1, -1)}
    for line in path.read_text(encoding="utf-8").splitlines():
        match line.split():
            case ["v", *numbers]:
                points.append([float(number) for number in numbers])
            case ["part", _, *names]:
                mirrors = [np.array(signs[name]) for name in names]
            case ["patch", *indices]:
                patch = np.array([points[int(i) - 1] for i in indices]).reshape(4, 4, 3)
                result.append(patch)
                # One mirror turns the patch inside out; its columns in reverse order turn it back.
                result += [(patch * m)[:, :: int(np.prod(m))] for m in mirrors]
    return np.array(result)


def tessellated(patches, cells):
    """Return an OBJ of Bézier patches, cells x cells squares of two triangles each, one at poles."""
    t = np.linspace(0, 1, cells + 1)
    basis = np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
    grids = np.einsum("iu,jv,pijk->puvk", basis, basis, patches)
    # Corners of neighbours are one vertex.
    numbers, lines, faces = {}, [], []
    for grid in grids:
        index = np.empty(grid.shape[:2], int)
        for at in np.ndindex(index.shape):
            key = tuple(np.round(grid[at], 6) + 0.0)
            if key not in numbers:
                numbers[key] = len(numbers) + 1
                lines.append("v {:g} {:g} {:g}".format(*key))
            index[at] = numbers[key]
        for u, v in np.ndindex(cells, cells):
            a, b, c, d = index[u, v], index[u + 1, v], index[u + 1, v + 1], index[u, v + 1]
            faces += [f"f {i} {j} {k}" for i, j, k in ((a, b, c), (a, c, d)) if len({i, j, k}) == 3]
    return "# Made by scripts/gallery of scenes/gallery/teapot.bezier.\n" + "\n".join(lines + faces) + "\n"


def prepare(scene):
    """Fetch and make what a scene needs."""
    # Scene files name their meshes in out/gallery/fetched.
    folder = ROOT / "out" / "gallery" / "fetched"
    for package in scene.packages:
        fetch(package, folder)
    if scene.name == "teapot":
        write(folder / "teapot.obj", tessellated(patches(SCENES / "teapot.bezier"), 6))


def antirad(*arguments, limit=None):
    """Run antirad; return its seconds, output and warnings, or None past the limit."""
    program = os.environ.get("ANTIRAD", "antirad")
    begin = time.monotonic()
    try:
        done = subprocess.run(
            [program, *map(str, arguments)],
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=limit,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None
    except OSError as error:
        raise GalleryError(
            f"{program} cannot be run: {error.strerror}; ANTIRAD=FILE names another"
        ) from error
    # 3: written, but it cannot be relied on.
    if done.returncode not in (0, 3):
        raise GalleryError(f"antirad {' '.join(map(str, arguments))} failed: {done.stderr.strip()}")
    warnings = [line.strip().removeprefix("WARN ") for line in done.stderr.splitlines() if "WARN" in line]
    return time.monotonic() - begin, done, warnings


def only(folder, suffix):
    """Return the one picture of a folder."""
    found = [path for path in sorted(folder.glob(f"*{suffix}")) if not path.name.endswith(f".error{suffix}")]
    if len(found) != 1:
        raise GalleryError(f"{folder} has {len(found)} pictures {suffix}, not one")
    return found[0]


def compared(truth, picture):
    """Return what `antirad compare` says of two pictures, as numbers."""
    _, done, _ = antirad("compare", truth, picture)
    number = r"([-+0-9.eE]+|NaN|inf)"
    error = re.search(rf"^difference\s+{number} % relative L2, relMSE {number}", done.stdout, re.M)
    noise = re.search(rf"^noise of the first\s+{number} % relative L2, relMSE {number}", done.stdout, re.M)
    mean = re.search(rf"^mean radiance\s+{number} %", done.stdout, re.M)
    if not (error and noise and mean):
        raise GalleryError(f"`antirad compare` answered what is not understood: {done.stdout.strip()}")
    return {
        "l2": float(error[1]),
        "relmse": float(error[2]),
        "noise_l2": float(noise[1]),
        "noise_relmse": float(noise[2]),
        "mean": float(mean[1]),
    }


def side_by_side(rendered, traced):
    """Return a PNG of two pictures and their difference: red is too bright, blue too dark, white right.

    The difference is that of squares of 2 x 2 pixels, less noisy. Few colours make a small file.
    """
    a, b = (np.asarray(Image.open(path).convert("RGB"), float) / 255 for path in (rendered, traced))
    height, width = (side // 2 for side in a.shape[:2])
    d = (a - b)[: 2 * height, : 2 * width].mean(axis=2).reshape(height, 2, width, 2).mean(axis=(1, 3))
    d = np.clip(FACTOR * d, -1, 1).repeat(2, axis=0).repeat(2, axis=1)[..., None]
    difference = np.where(d > 0, 1 - d * np.array([0, 1, 1]), 1 + d * np.array([1, 1, 0]))
    gap = np.ones((2 * height, 6, 3))
    parts = [part[: 2 * height, : 2 * width] for part in (a, b)]
    row = np.concatenate([parts[0], gap, parts[1], gap, difference], axis=1)
    picture = Image.fromarray(np.rint(255 * row).astype(np.uint8))
    stream = io.BytesIO()
    picture.quantize(256, dither=Image.Dither.NONE).save(stream, "PNG", optimize=True)
    return stream.getvalue()


def render(scene, output, target):
    """Render and trace a scene; return its row."""
    file = SCENES / scene.file
    folder = output / scene.name
    common = (file, "--exposure", scene.exposure)
    print(f"{scene.name}: rendering", flush=True)
    seconds, done, warnings = antirad("render", *common, "--output", folder / "rendered")
    report = json.loads((folder / "rendered" / "report.json").read_text())
    print(f"{scene.name}: {seconds:.1f} s; tracing, {scene.samples} samples a pixel", flush=True)
    traced, _, _ = antirad("trace", *common, "--samples", scene.samples, "--output", folder / "traced")
    truth = only(folder / "traced", ".exr")
    row = {
        "scene": scene.name,
        "reliable": done.returncode == 0,
        "triangles": report["plan"]["triangles"],
        "passes": report["solve"]["passes"],
        "lamps": report["plan"]["lamps"]["why"],
        "bins": report["plan"]["bins"],
        "spectral_radius": report["solve"]["spectral_radius"],
        "render_seconds": seconds,
        "trace_seconds": traced,
        "samples": scene.samples,
        "warnings": warnings,
        "accuracy_warnings": [warning["message"] for warning in report["accuracy_warnings"]],
        **compared(truth, only(folder / "rendered", ".exr")),
    }
    pictures = (only(folder / name, ".png") for name in ("rendered", "traced"))
    write(output / f"{scene.name}.png", side_by_side(*pictures))
    if target:
        limit = PATIENCE
        print(f"{scene.name}: --target-error {target}, at most {limit} s", flush=True)
        better = folder / "target"
        result = antirad("render", *common, "--target-error", target, "--output", better, limit=limit)
        row["target"] = {"error": target, "limit": limit}
        if result is not None:
            report = json.loads((better / "report.json").read_text())
            row["target"] |= {
                "seconds": result[0],
                "triangles": report["plan"]["triangles"],
                "warnings": result[2],
            }
            row["target"] |= compared(truth, only(better, ".exr"))
    write(output / f"{scene.name}.json", json.dumps(row, indent=2) + "\n")
    return row


def digits(value):
    return f"{value:.2g}" if abs(value) < 10 else f"{value:.0f}"


def without_noise(row):
    """Return the relative L2 error, less the noise of the truth."""
    return max(0.0, row["l2"] ** 2 - row["noise_l2"] ** 2) ** 0.5


def header(columns):
    return f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|\n"


def line(*cells):
    return f"| {' | '.join(cells)} |\n"


def tables(rows):
    """Return the tables as Markdown, and what antirad warned of."""
    text = header(COLUMNS)
    for row in rows:
        scene = next(scene for scene in GALLERY if scene.name == row["scene"])
        text += line(
            f"`{scene.name}`",
            scene.source,
            scene.licence,
            str(row["triangles"]),
            f"{digits(row['render_seconds'])} s{'' if row['reliable'] else ', exit code 3'}",
            str(row["passes"]),
            f"{digits(row['trace_seconds'])} s, {row['samples']}",
            f"{digits(row['noise_l2'])} %",
            f"{digits(without_noise(row))} %",
            f"{row['relmse']:.1e} ({row['noise_relmse']:.0e})",
            f"{row['mean']:+.2f} %",
        )
    with_target = [row for row in rows if "target" in row]
    if with_target:
        text += "\n" + header(TARGET_COLUMNS)
    for row in with_target:
        target = row["target"]
        begin = (f"`{row['scene']}`", f"{100 * target['error']:g} %")
        if "l2" not in target:
            text += line(*begin, "", f"more than {target['limit']} s", "", "", "")
            continue
        text += line(
            *begin,
            str(target["triangles"]),
            f"{digits(target['seconds'])} s",
            f"{digits(without_noise(target))} %",
            f"{target['relmse']:.1e}",
            f"{target['mean']:+.2f} %",
        )
    text += "\n"
    for row in rows:
        for warning in row["warnings"]:
            text += f"- `{row['scene']}`: {warning.replace(f'{SCENES}/../../', '').replace(f'{ROOT}/', '')}\n"
    return text


def update_docs(table, rows, output):
    """Put the tables into docs/gallery.md, and the pictures beside."""
    path = ROOT / "docs" / "gallery.md"
    text = path.read_text(encoding="utf-8")
    if any(text.count(mark) != 1 for mark in MARKS):
        raise GalleryError(f"{path} lacks the lines {MARKS[0]} and {MARKS[1]}")
    before, rest = text.split(MARKS[0])
    write(path, f"{before}{MARKS[0]}\n{table}{MARKS[1]}{rest.split(MARKS[1])[1]}")
    for row in rows:
        picture = (output / f"{row['scene']}.png").read_bytes()
        write(ROOT / "docs" / "images" / f"gallery_{row['scene']}.png", picture)


def arguments():
    parser = argparse.ArgumentParser(
        prog="gallery", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [scene.name for scene in GALLERY]
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"{', '.join(names)} [default: all]")
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "gallery")
    parser.add_argument("--fetch", action="store_true", help="fetch and make meshes, no more")
    parser.add_argument(
        "--samples", type=int, help="samples a pixel of the path tracer, in place of the usual"
    )
    parser.add_argument("--target", type=float, default=0.01, help="target error of a second render; 0: none")
    parser.add_argument("--docs", action="store_true", help="update docs/gallery.md and its pictures")
    options = parser.parse_args()
    unknown = sorted(set(options.scenes) - set(names))
    if unknown:
        parser.error(f"unknown scenes: {', '.join(unknown)}; known are {', '.join(names)}")
    return options


def main():
    options = arguments()
    output = options.output.resolve()
    scenes = [scene for scene in GALLERY if not options.scenes or scene.name in options.scenes]
    for scene in scenes:
        prepare(scene)
    if options.fetch:
        return
    if options.samples:
        scenes = [Scene(**(vars(scene) | {"samples": options.samples})) for scene in scenes]
    for scene in scenes:
        render(scene, output, options.target)
    # Scenes rendered before stay in the table.
    reports = [output / f"{scene.name}.json" for scene in GALLERY]
    rows = [json.loads(path.read_text()) for path in reports if path.exists()]
    table = tables(rows)
    write(output / "gallery.md", table)
    if options.docs:
        update_docs(table, rows, output)
    print(table)
    print(f"written to {output}")


if __name__ == "__main__":
    try:
        main()
    except GalleryError as error:
        sys.exit(f"gallery: {error}")
    except KeyboardInterrupt:
        sys.exit("gallery: interrupted")
