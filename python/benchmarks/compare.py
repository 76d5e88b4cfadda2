"""antirad beside Mitsuba 3 on the same scenes: error over time of pictures, of derivatives, and of a fit.

    scripts/compare                      # an hour or two on two cores
    scripts/compare --quick              # a minute: small pictures, few samples; figures mean nothing
    scripts/compare --scenes cornell_boxes --parts pictures gradients
    scripts/compare --scenes my/room.toml --parts tolerances    # whole commands, by --target-error

Writes to --output: results.json, comparison.md (the tables), and a plot for each scene and part.
"""

import argparse
import json
import os
import platform
import subprocess
import time
from pathlib import Path

import drjit as dr
import matplotlib
import mitsuba as mi
import numpy as np

import antirad

matplotlib.use("Agg")
import matplotlib.pyplot as plt

mi.set_variant("llvm_ad_rgb")
SCENES = Path(__file__).resolve().parents[2] / "scenes"
# Samples of a picture that Mitsuba traces at once: each takes some 200 bytes.
SAMPLES_AT_ONCE = 1 << 23


def relative_mse(picture, truth):
    """mean((I - R)² / (R² + .01)), over pixels and channels."""
    return float(np.mean((picture - truth) ** 2 / (truth**2 + 0.01)))


def relative_error(value, truth):
    return float(np.linalg.norm(value - truth) / np.linalg.norm(truth))


class Traced:
    """A scene in Mitsuba: pictures and derivatives by path tracing."""

    def __init__(self, scene, folder):
        scene.export(folder / f"{scene.name}.xml")
        self.scene = mi.load_file(str(folder / f"{scene.name}.xml"))
        self.path = mi.load_dict({"type": "path", "max_depth": -1})
        # Path replay: its memory does not grow with the number of bounces.
        self.replay = mi.load_dict({"type": "prb", "max_depth": -1})
        self.parameters = mi.traverse(self.scene)
        names = [material.name for material in scene.materials]
        # Per material, the keys of its albedo and of its lamps; the exporter numbers materials.
        self.albedo = {i: [f"m{i}.reflectance.value"] for i in range(len(names))}
        self.emission = {
            i: [k for k, _ in self.parameters.items() if k.endswith(f" {name}.emitter.radiance.value")]
            for i, name in enumerate(names)
        }
        self.albedo = {i: keys for i, keys in self.albedo.items() if keys[0] in self.parameters}
        self.emission = {i: keys for i, keys in self.emission.items() if keys}
        self.size = scene.cameras[0].width * scene.cameras[0].height
        self.seed = 0

    def passes(self, spp):
        """Split samples per pixel into passes."""
        most = max(1, SAMPLES_AT_ONCE // self.size)
        return [min(most, spp - first) for first in range(0, spp, most)]

    def next_seed(self):
        self.seed += 1
        return self.seed

    def picture(self, spp):
        total = 0
        for part in self.passes(spp):
            picture = mi.render(self.scene, integrator=self.path, spp=part, seed=self.next_seed())
            total = total + part * np.array(picture, dtype=np.float64)
        return total / spp

    def replayed(self, spp):
        """Render a picture that can be differentiated."""
        seeds = {"seed": self.next_seed(), "seed_grad": self.next_seed()}
        return mi.render(self.scene, self.parameters, integrator=self.replay, spp=spp, **seeds)

    def gradient(self, spp, cotangent):
        """Differentiate ⟨cotangent, picture⟩ by the logarithms of albedo and emission."""
        keys = [key for of in (self.albedo, self.emission) for keys in of.values() for key in keys]
        total, weights = {key: 0.0 for key in keys}, mi.TensorXf(cotangent)
        for part in self.passes(spp):
            for key in keys:
                dr.enable_grad(self.parameters[key])
                dr.set_grad(self.parameters[key], 0)
            picture = self.replayed(part)
            dr.backward(dr.sum(picture * weights, axis=None))
            for key in keys:
                total[key] = total[key] + part / spp * np.array(dr.grad(self.parameters[key])).reshape(3)
        for key in keys:
            dr.disable_grad(self.parameters[key])
        value = {key: np.array(self.parameters[key]).reshape(3) for key in keys}
        groups = [*self.albedo.values(), *self.emission.values()]
        return np.concatenate([sum(total[key] * value[key] for key in group) for group in groups])

    def set(self, albedo=None, emission=None):
        for of, values in ((self.albedo, albedo), (self.emission, emission)):
            for i, keys in of.items() if values is not None else ():
                for key in keys:
                    self.parameters[key] = mi.Color3f(*map(float, values[i]))
        self.parameters.update()


def timed(work):
    start = time.perf_counter()
    result = work()
    dr.sync_thread()
    return result, time.perf_counter() - start


def doublings(most):
    spp = 1
    while spp <= most:
        yield spp
        spp *= 2


def traced_curve(work, error, most, seconds, runs):
    """Error and time of one run, over samples per pixel: root mean square and mean of several runs."""
    curve = []
    for spp in doublings(most):
        work(spp)  # compiles
        errors, times = [], []
        for _ in range(runs):
            result, took = timed(lambda spp=spp: work(spp))
            errors.append(error(result))
            times.append(took)
        curve.append({"spp": spp, "seconds": float(np.mean(times)), "error": errors})
        if curve[-1]["seconds"] > seconds:
            break
    return curve


def variants(scene, quick):
    """Yield settings from fast to accurate, by name."""
    usual = scene.resolved(cut=False).scene
    yield "usual", usual
    yield "coarse bins", scene.with_settings(bins="6x8", near_field=10, tolerance=3e-3)
    if quick:
        return
    yield "fine bins", scene.with_settings(bins="20x26", near_field=60, tolerance=3e-4)
    finer = antirad.refine(usual, max_triangles=20_000).scene
    if len(finer.triangles) > len(scene.triangles):
        yield "usual, refined", finer
        yield "fine bins, refined", finer.with_settings(bins="20x26", near_field=60, tolerance=3e-4)


def best_of(work, runs):
    result, seconds = timed(work)
    for _ in range(runs - 1):
        seconds = min(seconds, timed(work)[1])
    return result, seconds


def pictures(scene, traced, truth, options):
    solved = []
    for name, variant in variants(scene, options.quick):

        def render(variant=variant):
            engine = antirad.Engine(variant)
            return engine.render(engine.solve(), supersample=options.supersample)

        picture, seconds = best_of(render, options.runs)
        error = relative_mse(np.asarray(picture, np.float64)[..., :3], truth)
        solved.append({"name": name, "seconds": seconds, "error": [error]})
    curve = traced_curve(
        traced.picture, lambda p: relative_mse(p, truth), options.spp, options.seconds, options.runs
    )
    return {"antirad": solved, "mitsuba": curve}


def gradients(scene, traced, truth, options):
    # What a fit from grey walls would ask for first.
    traced.set(albedo=np.full_like(scene.albedo, 0.5))
    grey = traced.picture(options.reference // 4 or 1)
    traced.set(albedo=scene.albedo)
    cotangent = (grey - truth) / (truth**2 + 0.01) / truth.size
    parts = [
        traced.gradient(max(1, options.reference // options.batches), cotangent)
        for _ in range(options.batches)
    ]
    reference = np.mean(parts, axis=0)
    noise = relative_error(reference, reference + np.std(parts, axis=0) / np.sqrt(len(parts)))
    solved = []
    for name, variant in variants(scene, options.quick):
        start = time.perf_counter()
        renderer = antirad.Renderer(
            variant, gradients=["albedo", "emission"], supersample=options.supersample
        )

        def both(change, variant=variant, renderer=renderer):
            values = {"albedo": variant.albedo * change}
            renderer.pictures(**values)
            return renderer.pull_back([cotangent], **values)

        found = both(1.0)
        first = time.perf_counter() - start
        # The next step of a fit: other materials, the same geometry.
        steps = [timed(lambda k=k: both(1.0 - 0.01 * k))[1] for k in range(1, 1 + options.runs)]
        groups = [(found.albedo, variant.albedo, i) for i in traced.albedo]
        groups += [(found.emission, variant.emission, i) for i in traced.emission]
        vector = np.concatenate([by[i] * value[i] for by, value, i in groups])
        error = relative_error(vector, reference)
        solved.append({"name": name, "seconds": first, "step": min(steps), "error": [error]})
    curve = traced_curve(
        lambda spp: traced.gradient(spp, cotangent),
        lambda g: relative_error(g, reference),
        options.spp,
        options.seconds,
        options.runs,
    )
    return {"antirad": solved, "mitsuba": curve, "reference noise": noise}


def fit(scene, traced, truth, options):
    """Fit walls and lamp from grey: root mean square error of albedos (absolute) and emission (relative)."""
    names = [material.name for material in scene.materials]
    lamps, walls = list(traced.emission), [i for i in traced.albedo if i not in traced.emission]
    start_albedo, start_emission = scene.albedo.copy(), scene.emission.copy()
    start_albedo[walls] = 0.5
    start_emission[lamps] = scene.emission[lamps].mean()
    epsilon = 0.1
    # The time to refine counts once, with each fit.
    finer, before = timed(lambda: antirad.refine(scene, max_triangles=20_000).scene)

    def distance(albedo, emission):
        differences = [albedo[walls] - scene.albedo[walls], emission[lamps] / scene.emission[lamps] - 1]
        return float(np.sqrt(np.mean(np.concatenate(differences) ** 2)))

    solved = []
    for iterations in (2, 4) if options.quick else (1, 2, 4, 8, 16, 32):
        result, seconds = timed(
            lambda iterations=iterations: antirad.fit(
                finer.replace(albedo=start_albedo, emission=start_emission),
                [antirad.Target(scene.cameras[0], truth)],
                [
                    antirad.Fit("albedo", materials=[names[i] for i in walls]),
                    antirad.Fit("emission", materials=[names[i] for i in lamps]),
                ],
                loss="relative-l2",
                epsilon=epsilon,
                iterations=iterations,
                relative_decrease=0.0,
                supersample=options.supersample,
            )
        )
        found = result.scene
        error = distance(found.albedo, found.emission)
        solved.append({"name": f"{iterations} iterations", "seconds": before + seconds, "error": [error]})

    target, curves = mi.TensorXf(truth), []
    rates = (0.05,) if options.quick else (0.01, 0.02, 0.05, 0.1, 0.2)
    for spp in (2,) if options.quick else (2, 8, 32):
        traced.gradient(spp, np.ones_like(truth))  # compiles
        for rate in rates:
            traced.set(start_albedo, start_emission)
            # Logits and logarithms keep albedos between 0 and 1, and light positive.
            optimiser = mi.ad.Adam(lr=rate)
            for i in walls:
                optimiser[f"albedo {i}"] = mi.Color3f(
                    *map(float, np.log(start_albedo[i] / (1 - start_albedo[i])))
                )
            for i in lamps:
                optimiser[f"emission {i}"] = mi.Color3f(*map(float, np.log(start_emission[i])))
            curve, spent = [], 0.0
            while spent < options.fit_seconds:
                begin = time.perf_counter()
                for i in walls:
                    for key in traced.albedo[i]:
                        traced.parameters[key] = 1 / (1 + dr.exp(-optimiser[f"albedo {i}"]))
                for i in lamps:
                    for key in traced.emission[i]:
                        traced.parameters[key] = dr.exp(optimiser[f"emission {i}"])
                traced.parameters.update()
                picture = traced.replayed(spp)
                loss = dr.mean((picture - target) ** 2 / (target**2 + epsilon**2), axis=None)
                dr.backward(loss)
                optimiser.step()
                dr.eval(optimiser)
                dr.sync_thread()
                spent += time.perf_counter() - begin
                albedo, emission = start_albedo.copy(), start_emission.copy()
                for i in walls:
                    albedo[i] = 1 / (1 + np.exp(-np.array(optimiser[f"albedo {i}"]).reshape(3)))
                for i in lamps:
                    emission[i] = np.exp(np.array(optimiser[f"emission {i}"]).reshape(3))
                curve.append({"seconds": spent, "error": [distance(albedo, emission)]})
            curves.append({"spp": spp, "rate": rate, "curve": curve})
    traced.set(scene.albedo, scene.emission)
    # The mean over the last tenth, since single steps are noise.
    tail = lambda c: np.mean([p["error"][0] for p in c["curve"][-max(1, len(c["curve"]) // 10) :]])  # noqa: E731
    best = min(curves, key=tail)
    others = [{"spp": c["spp"], "rate": c["rate"], "error": float(tail(c))} for c in curves]
    return {
        "antirad": solved,
        "mitsuba": best["curve"],
        "tuned": {"spp": best["spp"], "rate": best["rate"]},
        "tried": others,
    }


def tolerances(scene, traced, truth, options):
    """Render by the command line to several target errors; errors are without the noise of the reference."""
    folder = options.output / "tolerances"
    camera = scene.cameras[0]

    def error(picture):
        return max(relative_mse(picture, truth) - options.noise, 0.0)

    solved = []
    for tolerance in options.tolerances:
        command = [options.program, "render", options.file, "--camera", camera.name, "--quiet"]
        command += ["--supersample", str(options.supersample), "--output", folder]
        command += ["--target-error", str(tolerance)] if tolerance else []

        def render(command=command):
            # 3: written, above the target.
            if subprocess.run(command, check=False).returncode not in (0, 3):
                raise SystemExit(f"{command} failed")

        _, seconds = best_of(render, options.runs)
        picture = np.array(mi.Bitmap(str(folder / f"{camera.name}.exr")), dtype=np.float64)[..., :3]
        name = f"target {tolerance:.1%}" if tolerance else "no target"
        solved.append({"name": name, "seconds": seconds, "error": [error(picture)]})
        print(f"{name}: {seconds:.1f} s, {error(picture):.2e}", flush=True)
    curve = traced_curve(traced.picture, error, options.spp, options.seconds, options.runs)
    return {"antirad": solved, "mitsuba": curve}


MEASURES = {
    "tolerances": "relMSE",
    "pictures": "relMSE",
    "gradients": "relative error of the gradient",
    "fit": "error of albedo and emission",
}
PARTS = {"pictures": pictures, "gradients": gradients, "fit": fit, "tolerances": tolerances}
USUAL = ("pictures", "gradients", "fit")


def plot(scene, part, result, folder):
    figure, axes = plt.subplots(figsize=(5, 3.5))
    mean = lambda points: [np.mean(p["error"]) for p in points]  # noqa: E731
    curve = result["mitsuba"]
    axes.loglog([p["seconds"] for p in curve], mean(curve), "-", label="Mitsuba 3", color="tab:orange")
    solved = result["antirad"]
    axes.loglog([p["seconds"] for p in solved], mean(solved), "o", label="antirad", color="tab:blue")
    for point in solved:
        axes.annotate(point["name"], (point["seconds"], np.mean(point["error"])), fontsize=6)
    if part == "gradients":
        axes.loglog(
            [p["step"] for p in solved], mean(solved), "x", label="antirad, next step", color="tab:blue"
        )
    axes.set(xlabel="seconds", ylabel=MEASURES[part], title=f"{scene}: {part}")
    axes.grid(True, which="both", alpha=0.2)
    axes.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(folder / f"{scene}_{part}.png", dpi=150)
    plt.close(figure)


def seconds_until(curve, error):
    """Interpolate when the mean error of a curve first falls to another; None if it does not."""
    points = [(p["seconds"], np.mean(p["error"])) for p in curve]
    for k, (seconds, value) in enumerate(points):
        if value <= error:
            if k == 0:
                return seconds
            (s, e), share = points[k - 1], 0.0
            share = np.log(e / error) / np.log(e / value) if value < e else 1.0
            return float(s * (seconds / s) ** share)
    return None


def table(results):
    lines = [
        "| scene | part | antirad | s | error | Mitsuba: s to the same error | its error at the same time |",
        "|---|---|---|---|---|---|---|",
    ]
    for scene, parts in results["scenes"].items():
        for part, result in parts.items():
            if part not in PARTS:
                continue
            curve = result["mitsuba"]
            for point in result["antirad"]:
                seconds, error = point["seconds"], float(np.mean(point["error"]))
                until = seconds_until(curve, error)
                before = [p for p in curve if p["seconds"] <= seconds]
                then = f"{np.mean(before[-1]['error']):.2e}" if before else "-"
                shown = f"{seconds:.2f}" + (f" (next {point['step']:.2f})" if "step" in point else "")
                last = curve[-1]["seconds"]
                reached = f"{until:.2f}" if until is not None else f"more than {last:.0f}"
                lines.append(
                    f"| {scene} | {part} | {point['name']} | {shown} | {error:.2e} | {reached} | {then} |"
                )
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--scenes",
        nargs="+",
        default=["cornell_boxes", "two_rooms", "closed_box"],
        help="names in scenes/, or scene files",
    )
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(USUAL))
    parser.add_argument("--output", type=Path, default=Path("out/compare"))
    parser.add_argument("--reference", type=int, default=8192, help="samples per pixel of the reference")
    parser.add_argument("--batches", type=int, default=16, help="runs whose mean is the reference gradient")
    parser.add_argument("--spp", type=int, default=4096, help="most samples per pixel of Mitsuba's curves")
    parser.add_argument("--seconds", type=float, default=60, help="longest run of these curves")
    parser.add_argument("--fit-seconds", type=float, default=60, help="of each fit of Mitsuba")
    parser.add_argument("--runs", type=int, default=5, help="repetitions of each point")
    parser.add_argument("--supersample", type=int, default=8)
    parser.add_argument(
        "--tolerances", nargs="+", type=float, default=[0, 0.05, 0.02, 0.01, 0.005], help="0: none"
    )
    parser.add_argument("--program", type=Path, default=Path("target/release/antirad"))
    parser.add_argument("--width", type=int, help="of pictures [default: that of the scene's first camera]")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    if options.quick:
        options.width, options.reference, options.batches = options.width or 32, 64, 2
        options.spp, options.seconds, options.fit_seconds, options.runs = 8, 1.0, 2.0, 2
        if options.scenes == parser.get_default("scenes"):
            options.scenes = ["coarse_cornell"]
    options.output.mkdir(parents=True, exist_ok=True)
    backend = antirad.Backend()
    results = {
        "cores": os.cpu_count(),
        "machine": platform.processor() or platform.machine(),
        "antirad": f"{backend.kind} on {backend.device}, {backend.threads} threads",
        "mitsuba": f"{mi.__version__}, {mi.variant()}",
        "options": {k: str(v) for k, v in vars(options).items()},
        "scenes": {},
    }
    for name in options.scenes:
        options.file = Path(name) if name.endswith(".toml") else SCENES / f"{name}.toml"
        name = options.file.stem
        scene = antirad.Scene.load(options.file)
        camera = scene.cameras[0]
        if options.width:
            height = max(1, round(camera.height * options.width / camera.width))
            camera = camera.replace(width=options.width, height=height)
        scene = scene.replace(cameras=[camera])
        traced = Traced(scene, options.output)
        halves = [traced.picture(max(1, options.reference // 2)) for _ in range(2)]
        truth = (halves[0] + halves[1]) / 2
        of_scene = results["scenes"].setdefault(name, {})
        # The mean of two halves has half the variance of each, and their difference twice.
        options.noise = of_scene["reference noise"] = relative_mse(halves[0], halves[1]) / 4
        print(f"{name}: reference with relMSE {of_scene['reference noise']:.1e}", flush=True)
        for part in options.parts:
            of_scene[part] = PARTS[part](scene, traced, truth, options)
            plot(name, part, of_scene[part], options.output)
            print(f"{name}: {part} done", flush=True)
            (options.output / "results.json").write_text(json.dumps(results, indent=1))
            (options.output / "comparison.md").write_text(table(results))
    print(table(results))


if __name__ == "__main__":
    main()
