"""Pictures as a function of arrays, and its vector-Jacobian product: the part that PyTorch and JAX share."""

import weakref

from antirad._antirad import Renderer

#: What pictures can be differentiated by, in the order of the functions' arguments.
KINDS = ("emission", "albedo", "specular", "diffuse", "power", "vertices", "camera")

#: The renderer that was used last for each scene. One each, since it holds memory of the backend.
_renderers = weakref.WeakKeyDictionary()


class Function:
    """Pictures of some views of a scene, of the values of some kinds and of textures, in this order."""

    def __init__(self, scene, kinds, textures, views, supersample, shading, backend):
        """Take the renderer of the last call with the same arguments, or a new one.

        `textures`: name of a mesh, rows and columns of each.
        """
        self.kinds = tuple(kinds)
        textures = tuple(textures)
        self.one = isinstance(views, str) or (views is None and len(scene.cameras) == 1)
        views = (views,) if isinstance(views, str) else views if views is None else tuple(views)
        key = (self.kinds, textures, views, supersample, shading, backend)
        known, renderer = _renderers.get(scene, (None, None))
        if known != key:
            # First, so that its memory is free for the next one.
            _renderers.pop(scene, None)
            del renderer
            renderer = Renderer(
                scene,
                views=views,
                gradients=list(self.kinds),
                supersample=supersample,
                shading=shading,
                textures=textures,
                backend=backend,
            )
            _renderers[scene] = (key, renderer)
        self.renderer = renderer

    @property
    def shapes(self):
        """Shapes of the pictures."""
        return [(height, width, 3) for _, width, height in self.renderer.views]

    def pictures(self, values):
        """Render at values, in the order of the kinds."""
        return self.renderer.pictures(**self._named(values))

    def pull_back(self, values, cotangents):
        """Compute derivatives by the values from those by the pictures."""
        gradients = self.renderer.pull_back(cotangents, **self._named(values))
        by_kinds = [
            derivative(gradients, kind, value.shape) for kind, value in zip(self.kinds, values, strict=False)
        ]
        return by_kinds + (gradients.textures or [])

    def _named(self, values):
        """Return the values as arguments of the renderer."""
        count = len(self.kinds)
        kinds = dict(zip(self.kinds, values[:count], strict=True))
        return kinds | {"textures": list(values[count:])}


def derivative(gradients, kind, shape):
    """Return derivatives by values of a kind; those of cameras may be given without up."""
    by_values = getattr(gradients, kind)
    if kind == "camera":
        by_values = by_values[:, : shape[-2]]
    return by_values.reshape(shape)


def sizes(textures):
    """Return name, rows and columns of each texture of a dictionary from meshes to texels."""
    for name, texels in textures.items():
        if len(texels.shape) != 3 or texels.shape[2] != 3:
            shape = tuple(texels.shape)
            raise ValueError(f"the texture of {name!r} has the shape {shape}; it must be (rows, columns, 3)")
    return [(name, *texels.shape[:2]) for name, texels in textures.items()]


def given(**values):
    """Leave out those that are None, and keep the order of the kinds."""
    return {kind: values[kind] for kind in KINDS if values[kind] is not None}
