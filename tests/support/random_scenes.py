"""Random scenes of primitives, and their supersampled masks.

Every scene has a smooth body in front, two boxes of different colours that touch along a face,
struts a third of a pixel wide, and a light behind that some of them hide in part.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from godfit.scenes import mesh, projection, raster, visibility
from godfit.scenes.scene import Camera, Light, Object, Scene

FOV, DISTANCE = 50.0, 5.0
# Binary digits in which the samples of a pixel are counted.
DIGIT = 12
KINDS = (
    ("icosphere", {"radius": 0.6, "subdivisions": 2}),
    ("torus", {"radius": 0.6, "tube": 0.2, "radial_segments": 9, "tubular_segments": 20}),
    ("box", {"size": [0.9, 1.2, 0.7]}),
    ("cylinder", {"radius": 0.4, "height": 1.2, "segments": 16}),
)


def pixel(size: int) -> float:
    """How much of the world a pixel is wide, at the middle of the scenes."""
    return 2 * DISTANCE * np.tan(np.deg2rad(FOV) / 2) / size


def build(shape: mesh.Mesh, position, rotation=(0, 0, 0), scale=1.0, grey=0.0) -> Object:
    return Object(
        jnp.asarray(shape.vertices, float),
        jnp.asarray(shape.faces),
        jnp.asarray(mesh.edges(shape.faces)),
        jnp.asarray(position, float),
        jnp.asarray(rotation, float),
        jnp.asarray(scale, float),
        (grey, grey, grey),
    )


def draw(seed: int, size: int) -> Scene:
    """The same scene at every size, but for the width of its struts."""
    rng = np.random.default_rng(seed)

    def place(depth, reach):
        return (*rng.uniform(-reach, reach, 2), depth)

    kind, sizes = KINDS[seed % len(KINDS)]
    front = np.array(place(1.3, 0.5))
    objects = [build(mesh.primitive(kind, **sizes), front, rng.uniform(0, 360, 3))]
    # Side by side along the first axis of their common turn.
    turn, middle, box = rng.uniform(0, 360, 3), np.array(place(-0.7, 0.9)), mesh.primitive("box")
    left = build(box, middle, turn, 0.8, grey=0.3)
    corners, world = np.asarray(left.vertices), np.asarray(left.world())
    axis = world[corners[:, 0] > 0].mean(0) - world[corners[:, 0] < 0].mean(0)
    objects += [left, build(box, middle + axis, turn, 0.8, grey=0.6)]
    strut = mesh.primitive("cylinder", radius=0.15 * pixel(size), height=4.0, segments=6)
    for _ in range(3):
        objects.append(build(strut, place(0.2, 1.0), (0.0, 0.0, rng.uniform(0, 180)), 1.0, 0.0))
    # Where the light's centre comes to lie beside the outline of the body, as the camera sees it.
    around = rng.uniform(0, 2 * np.pi)
    light = [*(front[:2] * 8 / 3.7 + 1.4 * np.array([np.cos(around), np.sin(around)])), -3.0]
    radius = rng.uniform(0.5, 0.9)
    return Scene(
        Camera(
            jnp.asarray([*rng.uniform(-0.2, 0.2, 2), DISTANCE], float),
            jnp.zeros(3),
            jnp.asarray([0.07, 1.0, 0.0], float),
            jnp.asarray(FOV, float),
            0.1,
            100.0,
        ),
        Light(jnp.asarray(light, float), jnp.asarray(radius, float), (1.0, 1.0, 1.0)),
        tuple(objects),
        (0.1, 0.1, 0.1),
        (size, size),
    )


def supersampled(scene: Scene, factor: int = 32) -> np.ndarray:
    """(h, w, colours) share of every pixel, by factor x factor samples of what is nearest.

    The samples come from the hard masks' code, which has nothing in common with that of the
    contours, and which the tests hold against rays.
    """
    view = raster._view(scene)
    vertices, faces, face_label, _, centre, radius, focal = map(np.asarray, view)
    shape = projection.CameraMesh(vertices.astype(float), faces, face_label)
    sphere = projection.Sphere(centre.astype(float), float(radius))
    height, width = scene.size
    colours = raster.palette(scene)
    by_label = [scene.background, scene.light.colour, *(o.colour for o in scene.objects)]
    # One number counts all colours, each in its own binary digits.
    counter = np.array([1 << DIGIT * colours.index(c) for c in by_label])
    assert len(colours) * DIGIT < 64
    assert factor**2 < 2**DIGIT
    scale = 0.5 * height * factor * float(focal)
    share = np.empty((height, width, len(colours)))
    # In bands: at 512x512, all samples at once would be 3 GB.
    band = max(1, 2**22 // (width * factor**2))
    for first in range(0, height, band):
        rows = min(band, height - first)
        lens = projection.Lens(
            scale, scale, 0.5 * width * factor, (0.5 * height - first) * factor,
            scene.camera.near, scene.camera.far,
        )  # fmt: skip
        size = rows * factor, width * factor
        triangles, _ = projection.screen_triangles(shape, lens, size)
        projected = projection.ProjectedScene(triangles, sphere, lens)
        label, _ = visibility.label_pixels(projected, size)
        cells = counter[label].reshape(rows, factor, width, factor).sum(3).sum(1)
        counts = cells[..., None] >> DIGIT * np.arange(len(colours)) & (2**DIGIT - 1)
        share[first : first + rows] = counts / factor**2
    return share


def weight(size: tuple[int, int]) -> np.ndarray:
    """(h, w) smooth over the picture; a mask times it, summed, is a loss."""
    y, x = (np.mgrid[: size[0], : size[1]] + 0.5) / max(size)
    return 1 + 0.7 * np.sin(5 * x + 1) * np.cos(4 * y - 1) + 0.5 * x * y


def greys(scene: Scene) -> np.ndarray:
    return np.array([c[0] for c in raster.palette(scene)])


def loss(scene: Scene) -> jax.Array:
    mask = raster.rasterise(scene)
    return (mask * jnp.asarray(weight(scene.size), mask.dtype)).sum()
