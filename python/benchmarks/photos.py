"""antirad beside Mitsuba 3 on photographs of a room: the same unknowns, pictures and loss.

    scripts/compare photos FOLDER --held python/benchmarks/held0.json
    scripts/compare photos FOLDER --held ... --fits scan --settings 1x16x.02 4x16x.05d

FOLDER has transforms.json with EXR files, scan.obj, and true.obj with materials and lamps. --held describes a
view that no photo shows. Two fits:

    scan  scan.obj with its walls made plane: a texture for each mesh with texture coordinates, an albedo for
          each other mesh, and the emission of each candidate for a lamp that antirad finds
    true  true.obj: an albedo for each material without a texture, and the emission of each lamp

antirad runs once. Mitsuba minimises the same loss by Adam, with each of the settings VIEWSxSPPxRATE: photos
per step, samples per pixel, and the size of a step. 1x16x.02e.1d: steps of the logarithm of emission are .1,
and all become ten times smaller towards the end.
Both are measured by CPU time as well, which tells more where other programs run.
Writes to --output: photos.json, photos.md (the tables), and a plot for each fit.
"""

import argparse
import json
import os
import re
import shutil
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

import compare
import drjit as dr
import mitsuba as mi
import numpy as np

import antirad

compare.MEASURES["photos"] = "relMSE of a view that no photo shows"
HIGHEST_ALBEDO = 0.99
# The loss of antirad's fits of photographs: Huber's, relative to means of the target over the 5 x 5 pixels
# around, without the pixel itself.
REACH, EPSILON, THRESHOLD = 2, 0.1, 10.0
# Its total variation of textures, and its prior of albedos: weight and value.
EVENNESS, EDGE = 0.1, 0.02
OPEN, USUAL_ALBEDO = 0.01, 0.5


class Mesh:
    """Triangles of an OBJ file, or of a scene that antirad has saved."""

    def __init__(self, path):
        self.corners, self.uvs, self.objects, self.materials, self.library = [], [], [], [], {}
        if path.suffix == ".toml":
            for mesh in tomllib.loads(path.read_text())["mesh"]:
                self._read(path.parent / mesh["path"], mesh["name"])
        else:
            self._read(path)
        self.corners, self.uvs = np.array(self.corners), np.array(self.uvs)
        self.objects, self.materials = np.array(self.objects), np.array(self.materials)
        edges = self.corners[:, 1:] - self.corners[:, :1]
        self.areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2

    def _read(self, path, name=None):
        vertices, uvs, part, material = [], [], name, ""
        for line in path.read_text().splitlines():
            key, *words = line.split() or [""]
            if key == "v":
                vertices.append([float(word) for word in words[:3]])
            elif key == "vt":
                uvs.append([float(word) for word in words[:2]])
            elif key == "o":
                part = name or words[0]
            elif key == "usemtl":
                material = words[0]
            elif key == "mtllib":
                self._read_library(path.parent / words[0])
            elif key == "f":
                corners = [[int(i or 0) for i in word.split("/")] + [0] for word in words]
                self.corners.append([vertices[corner[0] - 1] for corner in corners])
                self.uvs.append([uvs[c[1] - 1] if c[1] else [np.nan] * 2 for c in corners])
                self.objects.append(part)
                self.materials.append(material)

    def _read_library(self, path):
        name = None
        for line in path.read_text().splitlines():
            key, *words = line.split() or [""]
            if key == "newmtl":
                name = words[0]
                self.library[name] = {"Kd": np.zeros(3), "Ke": np.zeros(3), "map_Kd": None}
            elif key in ("Kd", "Ke"):
                self.library[name][key] = np.array([float(word) for word in words])
            elif key == "map_Kd":
                self.library[name][key] = path.parent / words[0]

    def albedo(self):
        """Albedo of each triangle: of textures the mean over it."""
        found = np.array([self.library[name]["Kd"] for name in self.materials])
        for name in dict.fromkeys(self.materials):
            if (file := self.library[name]["map_Kd"]) is not None:
                faces = np.flatnonzero(self.materials == name)
                found[faces] = means_over_triangles(read_texture(file), self.uvs[faces])
        return found


def read_texture(path):
    """Read an sRGB picture as linear RGB."""
    bitmap = mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    return np.array(bitmap, dtype=np.float64)


def means_over_triangles(texture, uvs, cells=32):
    """Average a texture over each triangle: at the centres of equal parts of it."""
    height, width, _ = texture.shape
    i, j = np.divmod(np.arange(cells * cells), cells)
    upright, turned = i + j < cells, i + j < cells - 1
    u = np.concatenate([i[upright] + 1 / 3, i[turned] + 2 / 3]) / cells
    v = np.concatenate([j[upright] + 1 / 3, j[turned] + 2 / 3]) / cells
    at = np.stack([1 - u - v, u, v])
    means = []
    for corners in uvs:
        points = at.T @ corners
        columns = np.clip((points[:, 0] % 1 * width).astype(int), 0, width - 1)
        rows = np.clip(((1 - points[:, 1]) % 1 * height).astype(int), 0, height - 1)
        means.append(texture[rows, columns].mean(axis=0))
    return np.array(means)


@dataclass
class Part:
    """Triangles that share an albedo, or a texture, and an emission."""

    name: str
    faces: np.ndarray
    # An RGB triple, or a texture [rows, columns, 3].
    albedo: np.ndarray
    emission: np.ndarray | None
    fits_albedo: bool
    fits_emission: bool
    filtered: bool = True


class Fit:
    """What both programs do: pictures, unknowns and where they start, and how a result is judged."""

    def __init__(self, name, options):
        self.name, self.options = name, options
        self.folder = options.output / f"photos_{name}"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.job = self.folder / "job.toml"
        self.truth = Mesh(options.folder / "true.obj")
        held = json.loads(options.held.read_text())
        self.held_camera = antirad.Camera(**held["camera"])
        self.held = antirad.read_picture(options.folder / held["picture"])[..., :3]
        self.held_variance = np.load(options.folder / held["variance"])
        self.write_job()

    def write_job(self):
        photos = self.options.folder.resolve()
        if self.name == "scan":
            scan = Mesh(photos / "scan.obj")
            textured = sorted(set(scan.objects[np.isfinite(scan.uvs[:, 0, 0])]))
            others = [name for name in dict.fromkeys(scan.objects) if name not in textured]
            mesh = f'path = "{photos}/scan.obj"\nsnap = 0.01\nobjects = true\n'
            fits = f'[[fit]]\nparameter = "albedo"\nmeshes = {json.dumps(textured)}\nper = "texel"\n'
            fits += f"resolution = {self.options.resolution}\n\n"
            fits += f'[[fit]]\nparameter = "albedo"\nmeshes = {json.dumps(others)}\nper = "mesh"\n\n'
            fits += '[[fit]]\nparameter = "emission"\ndetect = true\n'
        else:
            library = self.truth.library.items()
            lamps = [name for name, of in library if of["Ke"].any()]
            plain = [name for name, of in library if name not in lamps and of["map_Kd"] is None]
            mesh = f'path = "{photos}/true.obj"\n'
            fits = f'[[fit]]\nparameter = "albedo"\nmaterials = {json.dumps(plain)}\ninitial = 0.5\n\n'
            fits += f'[[fit]]\nparameter = "emission"\nmaterials = {json.dumps(lamps)}\ninitial = 20\n'
        target = f'[[target]]\ncameras = "{photos}/transforms.json"\nsuffix = ".exr"\n'
        target += f"scale = {self.options.scale}\n"
        (self.folder / "scene.toml").write_text(f"[[mesh]]\n{mesh}")
        job = f'scene = "scene.toml"\n\n{target}\n{fits}\n[checkpoint]\nevery = {self.options.every}\n'
        self.job.write_text(job)

    def judge(self, first, second, albedo):
        """Judge two pictures of the held view, whose noise is independent, and albedos of triangles.

        Pictures are judged after the best gain of each channel.
        """
        weights = 1 / (self.held**2 + 0.01)
        above = (weights * self.held * (first + second) / 2).sum((0, 1))
        gains = above / (weights * first * second).sum((0, 1))
        products = (gains * first - self.held) * (gains * second - self.held)
        areas = self.truth.areas[:, None]
        off = (areas * (albedo - self.truth.albedo()) ** 2).sum() / (3 * areas.sum())
        error = float(np.mean((products - self.held_variance) * weights))
        return {"error": [error], "albedo": float(np.sqrt(off)), "gains": gains.tolist()}

    def by_antirad(self):
        """Fit once; checkpoints are kept while it runs, and judged afterwards."""
        checkpoints = self.folder / "checkpoints"
        shutil.rmtree(checkpoints, ignore_errors=True)
        marks, begin, begin_cpu = [], time.perf_counter(), time.process_time()

        def progress(record):
            spent = {"seconds": time.perf_counter() - begin, "cpu": time.process_time() - begin_cpu}
            if (checkpoints / "checkpoint").exists():
                # Of the multiple of `every` before this iteration.
                of = (record["iteration"] - 1) // self.options.every * self.options.every
                if of > 0 and not (self.folder / f"kept{of}").exists():
                    shutil.copytree(checkpoints, self.folder / f"kept{of}")
            marks.append({**record, **spent})
            print(
                f"antirad {record['iteration']}: {record['loss']:.4e}, {spent['seconds']:.1f} s", flush=True
            )

        for old in self.folder.glob("kept*"):
            shutil.rmtree(old)
        result = antirad.fit_job(self.job, checkpoints=checkpoints, progress=progress)
        end = {"seconds": time.perf_counter() - begin, "cpu": time.process_time() - begin_cpu}
        fine = marks[max(i for i, mark in enumerate(marks) if mark["iteration"] == 0) :]
        curve = []
        for mark in fine:
            kept = self.folder / f"kept{mark['iteration']}"
            if kept.exists():
                part = antirad.fit_job(self.job, iterations=mark["iteration"], checkpoints=kept, resume=True)
                curve.append(self.judge_antirad(part, mark))
                shutil.rmtree(kept)
        last = {**marks[-1], **end}
        curve.append(self.judge_antirad(result, last))
        return {"stop": result.stop, "curve": curve, "warnings": result.warnings, "history": marks}

    def judge_antirad(self, result, mark):
        scene = result.scene
        folder = self.folder / f"antirad{mark['iteration']}"
        folder.mkdir(exist_ok=True)
        scene.save(folder / "scene.toml")
        (folder / "recovered.json").write_text(json.dumps(result.recovered, indent=1))
        cameras = [{"name": c.name, **camera_fields(c)} for c in scene.cameras]
        (folder / "cameras.json").write_text(json.dumps(cameras, indent=1))
        engine = antirad.Engine(scene)
        picture = engine.render(engine.solve(), self.held_camera, supersample=8)
        picture = np.asarray(picture, np.float64)[..., :3]
        np.save(folder / "held.npy", picture.astype(np.float32))
        judged = self.judge(picture, picture, scene.albedo[scene.material_of])
        keys = ("iteration", "loss", "seconds", "cpu")
        name = f"{mark['iteration']} iterations"
        return {"name": name, **{k: mark[k] for k in keys}, **judged, "folder": str(folder)}

    def parts(self, folder):
        """Read what antirad has fitted, as parts, from the folder of a result."""
        recovered = json.loads((folder / "recovered.json").read_text())
        of = {(r["quantity"], r["of"]): np.array(r["value"]) for r in recovered}
        mesh = Mesh(folder / "scene.toml") if self.name == "scan" else self.truth
        labels = mesh.objects if self.name == "scan" else mesh.materials
        parts = []
        for name in dict.fromkeys(labels):
            faces = np.flatnonzero(labels == name)
            material = mesh.library[mesh.materials[faces[0]]]
            texture = None if material["map_Kd"] is None else read_texture(material["map_Kd"])
            albedo = of.get(("albedo", name), material["Kd"] if texture is None else texture)
            emission = of.get(("emission", name), material["Ke"])
            fits = self.name == "scan" or ("albedo", name) in of
            lamp = ("emission", name) in of
            emission = emission if lamp or emission.any() else None
            parts.append(Part(name, faces, albedo, emission, fits, lamp, filtered=self.name == "scan"))
        return mesh, parts


def camera_fields(camera):
    keys = ("position", "target", "up", "fov_x_degrees", "width", "height")
    return {key: getattr(camera, key) for key in keys}


class Traced:
    """The same fit by path tracing."""

    def __init__(self, fit, folder):
        self.fit = fit
        self.mesh, self.parts = fit.parts(folder)
        scene = {"type": "scene"}
        for part in self.parts:
            scene[part.name] = self.shape(part)
        cameras = [c for c in json.loads((folder / "cameras.json").read_text()) if c["name"] != "auto"]
        self.sensors = [self.sensor(camera) for camera in cameras]
        self.held = self.sensor(camera_fields(fit.held_camera))
        self.scene = mi.load_dict(scene)
        self.path = mi.load_dict({"type": "path", "max_depth": -1})
        self.replay = mi.load_dict({"type": "prb", "max_depth": fit.options.depth})
        self.parameters = mi.traverse(self.scene)
        self.seed = 0
        scale = round(1 / fit.options.scale)
        self.targets = [
            downscaled(antirad.read_picture(fit.options.folder / f"{c['name']}.exr")[..., :3], scale)
            for c in cameras
        ]
        epsilon = EPSILON * np.mean(self.targets)
        self.weights = [1 / np.hypot(local_means(target), epsilon) for target in self.targets]
        self.on_device = [
            (mi.TensorXf(t.astype(np.float32)), mi.TensorXf(w.astype(np.float32)))
            for t, w in zip(self.targets, self.weights, strict=True)
        ]

    def shape(self, part):
        file = self.fit.folder / f"{part.name}.obj"
        corners, uvs = self.mesh.corners[part.faces], self.mesh.uvs[part.faces]
        textured = np.ndim(part.albedo) == 3
        lines = ["v " + " ".join(map(repr, v)) for v in corners.reshape(-1, 3).tolist()]
        if textured:
            lines += ["vt " + " ".join(map(repr, v)) for v in uvs.reshape(-1, 2).tolist()]
        for i in range(1, len(corners) * 3, 3):
            words = (f"{k}/{k}" if textured else f"{k}" for k in (i, i + 1, i + 2))
            lines.append("f " + " ".join(words))
        file.write_text("\n".join(lines) + "\n")
        reflectance = {"type": "rgb", "value": part.albedo.tolist()} if not textured else None
        if textured:
            bitmap = mi.Bitmap(part.albedo.astype(np.float32))
            kind = "bilinear" if part.filtered else "nearest"
            reflectance = {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": kind}
            reflectance["wrap_mode"] = "clamp"
        shape = {"type": "obj", "filename": str(file), "face_normals": True}
        shape["bsdf"] = {"type": "diffuse", "reflectance": reflectance}
        if part.emission is not None:
            radiance = {"type": "rgb", "value": part.emission.tolist()}
            shape["emitter"] = {"type": "area", "radiance": radiance}
        return shape

    def sensor(self, camera):
        transform = mi.ScalarTransform4f().look_at(camera["position"], camera["target"], camera["up"])
        film = {
            "type": "hdrfilm",
            "width": camera["width"],
            "height": camera["height"],
            "pixel_format": "rgb",
        }
        film |= {"component_format": "float32", "rfilter": {"type": "box"}}
        sensor = {"type": "perspective", "fov": camera["fov_x_degrees"], "fov_axis": "x"}
        return mi.load_dict(sensor | {"to_world": transform, "film": film})

    def next_seed(self):
        self.seed += 1
        return self.seed

    def picture(self, sensor, spp):
        picture = mi.render(self.scene, sensor=sensor, integrator=self.path, spp=spp, seed=self.next_seed())
        return np.array(picture, dtype=np.float64)

    def replayed(self, view, spp):
        """Render a photo's view so that it can be differentiated."""
        seeds = {"seed": self.next_seed(), "seed_grad": self.next_seed()}
        of = {"sensor": self.sensors[view], "integrator": self.replay, "spp": spp}
        return mi.render(self.scene, self.parameters, **of, **seeds)

    def key(self, name, quantity):
        if quantity == "emission":
            return f"{name}.emitter.radiance.value"
        key = f"{name}.bsdf.reflectance."
        return key + "data" if key + "data" in self.parameters else key + "value"

    def set(self, values):
        for of, value in values.items():
            self.parameters[self.key(*of)] = on_device(value)
        self.parameters.update()

    def fitted(self):
        """Return what antirad has found: a value, or a texture, by name and quantity."""
        values = {(part.name, "albedo"): part.albedo for part in self.parts if part.fits_albedo}
        return values | {(part.name, "emission"): part.emission for part in self.parts if part.fits_emission}

    def start(self):
        """Start as antirad does: grey, and lamps scaled to the photos unless their start is stated."""
        grey = self.fit.name == "scan"
        start = {(name, of): np.full_like(value, 0.5) for (name, of), value in self.fitted().items()}
        lamps = [key for key in start if key[1] == "emission"]
        start |= {key: np.full(3, 1.0 if grey else 20.0) for key in lamps}
        if grey:
            self.set(start)
            above, below = 0.0, 0.0
            for sensor, target, weights in zip(self.sensors, self.targets, self.weights, strict=True):
                picture = self.picture(sensor, 32)
                above += (weights**2 * picture * target).sum((0, 1))
                below += (weights**2 * picture**2).sum((0, 1))
            start |= {key: above / below for key in lamps}
        return start

    def loss(self, picture, view):
        target, weights = self.on_device[view]
        u = dr.abs((picture - target) * weights)
        return dr.mean(dr.select(u < THRESHOLD, u * u, THRESHOLD * (2 * u - THRESHOLD)), axis=None)

    def unevenness(self, textures):
        """Total variation of textures, as antirad has it."""
        total, pairs = 0.0, 0
        for texture in textures:
            for d in (texture[1:] - texture[:-1], texture[:, 1:] - texture[:, :-1]):
                total += dr.sum(dr.sqrt(d * d + EDGE**2) - EDGE, axis=None)
                pairs += int(np.prod(d.shape))
        return EVENNESS * total / pairs

    def prior(self, albedos):
        """Mean squared distance of albedos from the usual one, in which a texture counts as one."""
        means = [dr.mean((albedo - USUAL_ALBEDO) ** 2, axis=None) for albedo in albedos]
        return OPEN * sum(means) / len(means)

    def adam(self, setting, cpu):
        """Run Adam for some CPU time: unknowns at about two moments in each doubling of it."""
        Adam(self, setting).step()  # compiles
        adam, kept = Adam(self, setting), []
        marks = [cpu * 2 ** (-k / 2) for k in range(10, -1, -1)]
        while adam.cpu < cpu:
            adam.step(adam.cpu / cpu)
            if adam.cpu >= marks[0]:
                spent = {"seconds": adam.seconds, "cpu": adam.cpu, "steps": adam.steps}
                kept.append((spent, adam.values()))
                marks = [mark for mark in marks if mark > adam.cpu]
        return kept

    def true_values(self):
        """Return what was photographed, for the unknowns of a fit of the true mesh."""
        library = self.fit.truth.library
        keys = {"albedo": "Kd", "emission": "Ke"}
        return {(name, of): library[name][keys[of]] for name, of in self.fitted()}

    def judged(self, values):
        """Judge values by pictures of many samples."""
        self.set(values)
        spp = self.fit.options.judge_spp // 2
        return self.fit.judge(self.picture(self.held, spp), self.picture(self.held, spp), self.albedo(values))

    def albedo(self, values):
        found = np.empty_like(self.mesh.corners[:, 0])
        for part in self.parts:
            value = values.get((part.name, "albedo"), part.albedo)
            textured = np.ndim(value) == 3
            found[part.faces] = means_over_triangles(value, self.mesh.uvs[part.faces]) if textured else value
        return found


def on_device(value):
    if np.ndim(value) == 3:
        return mi.TensorXf(np.ascontiguousarray(value, dtype=np.float32))
    return mi.Color3f(*map(float, value))


def downscaled(picture, scale):
    height, width, channels = picture.shape
    return picture.reshape(height // scale, scale, width // scale, scale, channels).mean((1, 3))


def local_means(picture):
    """Mean over the squares around pixels, without the pixel itself, cut off at the border."""
    total, count = np.zeros_like(picture), np.zeros((*picture.shape[:2], 1))
    height, width, _ = picture.shape
    for dy in range(-REACH, REACH + 1):
        for dx in range(-REACH, REACH + 1):
            if (dy, dx) == (0, 0):
                continue
            ys, xs = slice(max(0, dy), height + min(0, dy)), slice(max(0, dx), width + min(0, dx))
            yt, xt = slice(max(0, -dy), height + min(0, -dy)), slice(max(0, -dx), width + min(0, -dx))
            total[yt, xt] += picture[ys, xs]
            count[yt, xt] += 1
    return total / count


class Setting:
    """VIEWSxSPPxRATE, then "e" and the rate of emission if it differs, then "d" if steps become smaller."""

    def __init__(self, text):
        pattern = r"(\d+)x(\d+)x([\d.]+)(?:e([\d.]+))?(d?)"
        views, spp, rate, emission, decay = re.fullmatch(pattern, text).groups()
        self.text, self.views, self.spp, self.decays = text, int(views), int(spp), bool(decay)
        self.rates = {"albedo": float(rate), "emission": float(emission or rate)}


class Adam:
    """A run of Adam. Steps of emission are those of its logarithm, since its size is unknown."""

    def __init__(self, traced, setting):
        self.traced, self.setting = traced, setting
        self.start = traced.start()
        self.optimiser = mi.ad.Adam(lr=setting.rates["albedo"])
        self.names = {key: " ".join(key) for key in self.start}
        for key, value in self.start.items():
            self.optimiser[self.names[key]] = on_device(np.log(value) if key[1] == "emission" else value)
        self.random = np.random.default_rng(0)
        self.seconds = self.cpu = 0.0
        self.steps = 0

    def now(self, key):
        value = self.optimiser[self.names[key]]
        return dr.exp(value) if key[1] == "emission" else value

    def values(self):
        return {k: np.array(self.now(k), dtype=np.float64).reshape(v.shape) for k, v in self.start.items()}

    def step(self, share=0.0):
        begin, begin_cpu = time.perf_counter(), time.process_time()
        traced, setting = self.traced, self.setting
        factor = 0.1**share if setting.decays else 1.0
        rates = {name: factor * setting.rates[key[1]] for key, name in self.names.items()}
        self.optimiser.set_learning_rate(rates)
        for key in self.start:
            traced.parameters[traced.key(*key)] = self.now(key)
        traced.parameters.update()
        total = 0.0
        for view in self.random.choice(len(traced.sensors), setting.views, replace=False):
            total += traced.loss(traced.replayed(view, setting.spp), view) / setting.views
        textures = [self.optimiser[self.names[k]] for k, v in self.start.items() if np.ndim(v) == 3]
        if textures:
            total += traced.unevenness(textures)
        total += traced.prior([self.optimiser[self.names[key]] for key in self.start if key[1] == "albedo"])
        dr.backward(total)
        self.optimiser.step()
        for key, name in self.names.items():
            if key[1] == "albedo":
                self.optimiser[name] = dr.clip(self.optimiser[name], 0, HIGHEST_ALBEDO)
        dr.eval(self.optimiser)
        dr.sync_thread()
        self.steps += 1
        self.seconds += time.perf_counter() - begin
        self.cpu += time.process_time() - begin_cpu


def run(name, options):
    fit = Fit(name, options)
    stored = fit.folder / "antirad.json"
    ours = json.loads(stored.read_text()) if options.reuse and stored.exists() else fit.by_antirad()
    last = ours["curve"][-1]
    traced = Traced(fit, Path(last["folder"]))
    if "traced" not in last:
        last["traced"] = traced.judged(traced.fitted())["error"]
    stored.write_text(json.dumps(ours, indent=1))
    result = {"antirad": ours["curve"], "tried": []}
    if name == "true":
        result["truth"] = traced.judged(traced.true_values())["error"]
    print(
        f"{name}: antirad's result, path-traced: {last['traced']}; the truth: {result.get('truth')}",
        flush=True,
    )
    for cpu in options.cpu:
        for setting in map(Setting, options.settings):
            load = os.getloadavg()[0]
            curve = [{**at, **traced.judged(v)} for at, v in traced.adam(setting, cpu * last["cpu"])]
            result["tried"].append({"setting": setting.text, "load": load, "curve": curve})
            end = curve[-1]
            spent = f"{end['seconds']:.0f} s, CPU {end['cpu']:.0f} s, {end['steps']} steps, load {load:.1f}"
            found = f"held view {end['error'][0]:.2e}, albedo {end['albedo']:.3f}"
            print(f"{name} {setting.text}: {spent}: {found}", flush=True)
    best = min(result["tried"], key=lambda run: run["curve"][-1]["error"][0])
    return result | {"mitsuba": best["curve"], "setting": best["setting"]}


def cpu_until(tried, error):
    """CPU time until the first of some runs has fallen to an error; None if none does."""
    curves = [[{"seconds": at["cpu"], "error": at["error"]} for at in run["curve"]] for run in tried]
    found = [compare.seconds_until(curve, error) for curve in curves]
    return min((cpu for cpu in found if cpu is not None), default=None)


def table(results):
    lines = [
        "| fit | program | s | CPU s | held view, relMSE | albedo, rms | Mitsuba: CPU s to the same relMSE |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, result in results["fits"].items():
        rows = [(f"antirad, {point['name']}", point, True) for point in result["antirad"]]
        for tried in result["tried"]:
            end = tried["curve"][-1]
            rows.append((f"Mitsuba, {tried['setting']}, {end['steps']} steps", end, False))
        for program, at, ours in rows:
            until = cpu_until(result["tried"], at["error"][0]) if ours else None
            longest = max(run["curve"][-1]["cpu"] for run in result["tried"])
            reached = f"{until:.0f}" if until is not None else f"more than {longest:.0f}"
            lines.append(
                f"| {name} | {program} | {at['seconds']:.0f} | {at['cpu']:.0f} |"
                f" {at['error'][0]:.2e} | {at['albedo']:.3f} | {reached if ours else ''} |"
            )
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="photographs, poses and meshes")
    parser.add_argument(
        "--held", type=Path, required=True, help="JSON: picture, variance and camera of a view"
    )
    parser.add_argument("--fits", nargs="+", choices=["scan", "true"], default=["true", "scan"])
    parser.add_argument("--settings", nargs="+", default=["1x16x.02d", "1x16x.05d", "3x16x.02d", "3x16x.05d"])
    parser.add_argument(
        "--cpu", nargs="+", type=float, default=[1, 2], help="CPU time of Adam, in multiples of antirad's"
    )
    parser.add_argument("--output", type=Path, default=Path("out/compare"))
    parser.add_argument("--resolution", type=int, default=128, help="columns and rows of each texture")
    parser.add_argument("--scale", type=float, default=0.5, help="of pictures")
    parser.add_argument(
        "--every", type=int, default=4, help="iterations of antirad from one point to the next"
    )
    parser.add_argument("--depth", type=int, default=-1, help="most bounces of Mitsuba's fits")
    parser.add_argument("--judge-spp", type=int, default=512, help="samples per pixel of judged pictures")
    parser.add_argument("--reuse", action="store_true", help="take antirad's result from an earlier run")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    backend = antirad.Backend()
    results = {
        "cores": os.cpu_count(),
        "antirad": f"{backend.kind} on {backend.device}, {backend.threads} threads",
        "mitsuba": f"{mi.__version__}, {mi.variant()}",
        "options": {k: str(v) for k, v in vars(options).items()},
        "fits": {},
    }
    for name in options.fits:
        results["fits"][name] = run(name, options)
        compare.plot(name, "photos", results["fits"][name], options.output)
        (options.output / "photos.json").write_text(json.dumps(results, indent=1))
        (options.output / "photos.md").write_text(table(results))
    print(table(results))


if __name__ == "__main__":
    main()
