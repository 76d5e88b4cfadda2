"""Small scenes from arrays."""

import numpy as np

import antirad


class Builder:
    """Collects quads, each cut into cells of two triangles."""

    def __init__(self):
        self.vertices, self.triangles, self.material_of, self.meshes = [], [], [], []

    def quad(self, corner, u, v, cells, material):
        """A parallelogram whose front is where u x v points."""
        corner, u, v = (np.asarray(x, float) for x in (corner, u, v))
        first = len(self.vertices)
        for j in range(cells + 1):
            for i in range(cells + 1):
                self.vertices.append(corner + u * (i / cells) + v * (j / cells))
        for j in range(cells):
            for i in range(cells):
                a = first + j * (cells + 1) + i
                b, c, d = a + 1, a + cells + 2, a + cells + 1
                self.triangles += [(a, b, c), (a, c, d)]
                self.material_of += [material, material]

    def box(self, low, high, cells, material, inside=False):
        """Six walls, with their fronts outside or inside."""
        low, high = np.asarray(low, float), np.asarray(high, float)
        size = high - low
        for axis in range(3):
            u, v = np.zeros(3), np.zeros(3)
            u[(axis + 1) % 3], v[(axis + 2) % 3] = size[(axis + 1) % 3], size[(axis + 2) % 3]
            far = low.copy()
            far[axis] = high[axis]
            pairs = [(low, v, u), (far, u, v)]
            for corner, a, b in pairs:
                if inside:
                    a, b = b, a
                self.quad(corner, a, b, cells, material)

    def mesh(self, name):
        """Ends a mesh that began where the last one ended."""
        self.meshes.append((name, len(self.triangles) - sum(count for _, count in self.meshes)))

    def scene(self, materials, cameras):
        return antirad.Scene.from_arrays(
            np.array(self.vertices),
            np.array(self.triangles),
            materials,
            cameras,
            material_of=self.material_of,
            meshes=self.meshes,
            name="room",
        )


def room(width=12, height=8, cells=2):
    """A grey room of 2 m with a coloured block and a lamp under the ceiling; cells² quads per wall."""
    build = Builder()
    build.box((-1, -1, -1), (1, 1, 1), cells, 0, inside=True)
    build.mesh("walls")
    build.box((-0.2, -0.9, -0.3), (0.4, -0.3, 0.3), 1, 1)
    build.mesh("block")
    build.quad((-0.3, 0.95, -0.3), (0.6, 0, 0), (0, 0, 0.6), 1, 2)
    build.mesh("lamp")
    materials = [
        antirad.Material("wall", albedo=(0.6, 0.5, 0.4)),
        antirad.Material("paint", albedo=(0.2, 0.5, 0.7)),
        antirad.Material("light", emission=(3.0, 2.5, 2.0), albedo=0.1),
    ]
    camera = antirad.Camera(
        (0.3, 0.1, 0.95), (0.0, -0.4, -0.6), fov_x_degrees=80, width=width, height=height, name="main"
    )
    # Coarse, so that tests take moments.
    return build.scene(materials, [camera]).with_settings(bins="4x6", near_field=4)


def exact(scene):
    """The same scene, solved in double precision nearly to its end."""
    return scene.with_settings(precision="f64", tolerance=1e-11)


def textured(folder, width=12, height=8):
    """A floor of 3 x 3 quads with texture coordinates in front of a wall, under a lamp, from a file."""
    lines = ["mtllib s.mtl", "o floor", "usemtl grey"]
    for row in range(4):
        for column in range(4):
            x, z = column / 3, row / 3
            lines += [f"v {x} 0 {z}", f"vt {0.05 + 0.9 * x} {0.05 + 0.9 * z}"]
    for row in range(3):
        for column in range(3):
            a = 4 * row + column + 1
            b, c, d = a + 1, a + 5, a + 4
            lines += [f"f {a}/{a} {d}/{d} {c}/{c}", f"f {a}/{a} {c}/{c} {b}/{b}"]
    lines += ["o wall", "usemtl grey", "v 0 0 0", "v 1 0 0", "v 1 1 0", "v 0 1 0", "f -4 -3 -2", "f -4 -2 -1"]
    lines += [
        "o lamp",
        "usemtl lamp",
        "v .3 1 .3",
        "v .7 1 .3",
        "v .7 1 .7",
        "v .3 1 .7",
        "f -4 -3 -2",
        "f -4 -2 -1",
    ]
    (folder / "s.obj").write_text("\n".join(lines))
    (folder / "s.mtl").write_text("newmtl grey\nKd .5 .5 .5\nnewmtl lamp\nKd 0 0 0\nKe 5 5 5\n")
    (folder / "s.toml").write_text('[[mesh]]\npath = "s.obj"\nobjects = true\norient = "keep"\n')
    camera = antirad.Camera(
        (0.2, 1.2, 1.6), (0.5, 0.1, 0.4), fov_x_degrees=50, width=width, height=height, name="main"
    )
    scene = antirad.Scene.load(folder / "s.toml").replace(cameras=[camera])
    return scene.with_settings(bins="4x6", near_field=4)
