"""Scene -> occlusion mask, anti-aliased exactly and differentiable at its contours.

What is visible is piecewise constant and has no derivative: it comes from compiled code
(``visibility.py``, ``contours.py``) behind a callback. All the derivative lies in the contours (Li,
Aittala, Durand & Lehtinen, SIGGRAPH Asia 2018, section 4): as an edge's ends move on the screen, it
sweeps over so much of a pixel, and the pixel goes from the colour on one side to that on the other.
The ends are functions of the scene in JAX, so that forward and reverse mode reach objects, camera
and light. A line in which two surfaces pass through each other moves as their depths do.

The light is a sphere. Its outline is the circle in which the cone of tangents from the camera
touches it, drawn as a polygon of equal area with OUTLINE corners; inside and depth are exact.
"""

from __future__ import annotations

import functools
import threading
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.errors import InputError
from godfit.scenes.scene import Scene

OUTLINE = 512
# Fragments of contour (one edge in one pixel) that a picture has room for, beside a quarter of its
# pixels. A skull of 31,016 triangles at 512x512 has 8,000.
FRAGMENTS = 1 << 16
# The same for pieces of lines of intersection, some ten in a pixel, beside an eighth of its pixels.
CROSSINGS = 1 << 15

# The callbacks share the machine's cores already: two at once would only be in each other's way.
_one_at_a_time = threading.Lock()


class Visible(NamedTuple):
    """At the pixel centres: label (h, w), 0 background, 1 light, 2 + i object i; and depth (h, w)
    along the view, infinite where nothing is."""

    label: Int[Array, "h w"]
    depth: Float[Array, "h w"]


def palette(scene: Scene) -> tuple[tuple[float, float, float], ...]:
    """The different colours of a scene, that of the background first."""
    found = [scene.background, scene.light.colour, *(o.colour for o in scene.objects)]
    return tuple(dict.fromkeys(found))


def rasterise(
    scene: Scene, *, antialias: bool = True, still: bool = False
) -> Float[Array, "h w"] | Float[Array, "..."]:
    """The occlusion mask of a scene: (h, w), or (h, w, 3) where a colour is not grey; row 0 at the
    top, linear.

    With ``antialias`` a pixel is the mean over its area, exactly, and the mask is differentiable in
    the positions, rotations and scales of the objects, the camera and the light. Without, it has
    the colour of its centre, as WebGL draws it, and the derivative is zero, as it is of a
    ``still``, which has less to compile.

    Raises InputError for a light that is not before the camera, and where the contours have more
    fragments than ``FRAGMENTS`` and ``CROSSINGS`` leave room for.
    """
    colours = np.array(palette(scene))
    grey = (colours == colours[:, :1]).all()
    values = jnp.asarray(colours[:, 0] if grey else colours, scene.light.position.dtype)
    if antialias:
        return coverage(scene, still=still) @ values
    colour_of = np.array([palette(scene).index(c) for c in _colours(scene)])
    return values[jnp.asarray(colour_of)[visible(scene).label]]


def visible(scene: Scene) -> Visible:
    """What is seen through the pixel centres. Piecewise constant: without derivative."""
    view = _view(scene)
    dtype = scene.light.position.dtype
    shape = (
        jax.ShapeDtypeStruct(scene.size, jnp.int32),
        jax.ShapeDtypeStruct(scene.size, dtype),
    )
    label, depth = jax.pure_callback(
        functools.partial(_visible, scene.size, scene.camera.near, scene.camera.far),
        shape,
        *jax.lax.stop_gradient(view),
        vmap_method="sequential",
    )
    return Visible(label, depth)


def coverage(scene: Scene, *, still: bool = False) -> Float[Array, "h w colours"]:
    """The share of every pixel that each colour of ``palette`` covers; sums to one. ``still`` has
    no derivative, and less to compile."""
    height, width = scene.size
    colours = palette(scene)
    colour_of = tuple(colours.index(c) for c in _colours(scene))
    room, crossings = _room(scene.size)
    dtype = scene.light.position.dtype
    view = _view(scene)
    shape = (
        jax.ShapeDtypeStruct((height, width, len(colours)), dtype),
        jax.ShapeDtypeStruct((), jnp.int32),
        jax.ShapeDtypeStruct((room,), jnp.int32),
        jax.ShapeDtypeStruct((room, 4), jnp.int32),
        jax.ShapeDtypeStruct((room, len(colours), 4), dtype),
        jax.ShapeDtypeStruct((), jnp.int32),
        jax.ShapeDtypeStruct((crossings,), jnp.int32),
        jax.ShapeDtypeStruct((crossings, 2), jnp.int32),
        jax.ShapeDtypeStruct((crossings, 2), dtype),
        jax.ShapeDtypeStruct((crossings, len(colours)), dtype),
    )
    share, count, pixel, made_of, weight, crossed, *lines = jax.pure_callback(
        functools.partial(_contours, scene.size, scene.camera.near, scene.camera.far, colour_of),
        shape,
        *jax.lax.stop_gradient(view),
        vmap_method="sequential",
    )
    if still:
        return share
    share = share.reshape(-1, len(colours))

    def follow(size: int, share, view):
        """Zero is added, with the derivative of the first ``size`` fragments."""
        ends = [_screen(scene, view, made_of[:size, k], made_of[:size, k + 1]) for k in (0, 2)]
        ends = jnp.concatenate(ends, -1)
        moved = jnp.einsum("fck,fk->fc", weight[:size], ends - jax.lax.stop_gradient(ends))
        return share.at[pixel[:size]].add(moved)

    def follow_lines(share, view):
        at, faces, place, weight = lines
        one, other = (_inverse_depth(scene, view, faces[:, k], place) for k in (0, 1))
        ahead = one - other
        return share.at[at].add(weight * (ahead - jax.lax.stop_gradient(ahead))[:, None])

    # Most pictures have few: three sizes of one program, so that these do not pay for all.
    sizes = (room // 32, room // 8, room)
    which = (count > sizes[0]).astype(jnp.int32) + (count > sizes[1])
    share = jax.lax.switch(which, [functools.partial(follow, n) for n in sizes], share, view)
    if scene.objects:
        share = jax.lax.cond(crossed > 0, follow_lines, lambda share, _: share, share, view)
    return share.reshape(height, width, len(colours))


def on_screen(scene: Scene) -> Float[Array, "2"]:
    """Texture coordinates (u, v) of the light's centre, on the screen or off it. The light must lie
    before the camera: the rays of one behind it would be mirrored."""
    x, y, z = scene.camera_axes() @ (scene.light.position - scene.camera.position)
    focal = _focal(scene)
    aspect = scene.size[1] / scene.size[0]
    return jnp.stack([0.5 + 0.5 * focal / aspect * x / -z, 0.5 + 0.5 * focal * y / -z])


class _View(NamedTuple):
    """What the callbacks are given: vertices in camera space, the outline's last, and the rest."""

    vertices: Float[Array, "v 3"]
    faces: Int[Array, "f 3"]
    face_label: Int[Array, " f"]
    edges: Int[Array, "e 4"]
    centre: Float[Array, "3"]
    radius: Float[Array, ""]
    focal: Float[Array, ""]


def _colours(scene: Scene):
    """Colour by label."""
    return [scene.background, scene.light.colour, *(o.colour for o in scene.objects)]


def _focal(scene: Scene) -> Float[Array, ""]:
    return 1 / jnp.tan(jnp.deg2rad(scene.camera.fov_y) / 2)


def _view(scene: Scene) -> _View:
    turn = scene.camera_axes()

    def seen(points):
        return (points - scene.camera.position[None]) @ turn.T

    centre = seen(scene.light.position[None])[0]
    vertices, faces, labels, edges, first = [], [], [], [], 0
    for i, thing in enumerate(scene.objects):
        vertices.append(seen(thing.world()))
        faces.append(thing.faces + first)
        # -1 and -2 are no vertices.
        edges.append(jnp.where(thing.edges < 0, thing.edges, thing.edges + first))
        labels.append(jnp.full(thing.faces.shape[0], i + 2, jnp.int32))
        first += thing.vertices.shape[0]
    vertices.append(_outline(centre, scene.light.radius))
    none = jnp.zeros((0, 3), jnp.int32), jnp.zeros(0, jnp.int32), jnp.zeros((0, 4), jnp.int32)
    return _View(
        jnp.concatenate(vertices),
        jnp.concatenate([none[0], *faces]),
        jnp.concatenate([none[1], *labels]),
        jnp.concatenate([none[2], *edges]),
        centre,
        scene.light.radius,
        _focal(scene),
    )


def _outline(centre: Float[Array, "3"], radius: Float[Array, ""]) -> Float[Array, "n 3"]:
    """Corners of the light's outline in camera space."""
    squared = centre @ centre
    axis = centre / jnp.sqrt(squared)
    # Two directions across the axis (Duff et al., JCGT 6 (2017), 1).
    sign = jnp.where(axis[2] < 0, -1.0, 1.0).astype(centre.dtype)
    a = -1 / (sign + axis[2])
    b = axis[0] * axis[1] * a
    across = jnp.stack([1 + sign * axis[0] ** 2 * a, sign * b, -sign * axis[0]])
    up = jnp.stack([b, sign + axis[1] ** 2 * a, -axis[1]])
    share = radius**2 / squared
    turn = 2 * np.pi / OUTLINE
    # The corners lie a little outside, for the area of the circle.
    size = radius * jnp.sqrt(jnp.maximum(1 - share, 0)) * np.sqrt(turn / np.sin(turn))
    angle = np.arange(OUTLINE) * turn
    circle = jnp.asarray(np.cos(angle), centre.dtype)[:, None] * across[None]
    circle = circle + jnp.asarray(np.sin(angle), centre.dtype)[:, None] * up[None]
    return centre[None] * (1 - share) + size * circle


def _screen(scene: Scene, view: _View, i: Int[Array, " f"], j: Int[Array, " f"]):
    """(f, 2) x and y in pixels of the points made of vertices i and j; see ``projection.Edges``."""
    a, b = view.vertices[i], view.vertices[j]
    drop = b[:, 2] - a[:, 2]
    share = jnp.where(i == j, 0.0, (-scene.camera.near - a[:, 2]) / jnp.where(i == j, 1.0, drop))
    x, y, z = jnp.moveaxis(a + share[:, None] * (b - a), -1, 0)
    # Unused fragments are made of any vertex, which may lie in the camera's plane.
    depth = jnp.where(-z > 0.5 * scene.camera.near, -z, 1.0)
    height, width = scene.size
    scale = 0.5 * height * view.focal / depth
    return jnp.stack([0.5 * width + scale * x, 0.5 * height - scale * y], -1)


def _inverse_depth(scene: Scene, view: _View, face: Int[Array, " n"], place: Float[Array, "n 2"]):
    """(n,) 1/depth under places on the screen, in pixels: of the planes of faces, or of the light's
    sphere where the face is -1."""
    height, width = scene.size
    scale = 0.5 * height * view.focal
    x, y = (place[:, 0] - 0.5 * width) / scale, (0.5 * height - place[:, 1]) / scale
    ray = jnp.stack([x, y, -jnp.ones_like(x)], -1)
    a, b, c = (view.vertices[view.faces[face, k]] for k in range(3))
    normal = jnp.cross(b - a, c - a)
    height_of = (normal * a).sum(-1)
    of_plane = (normal * ray).sum(-1) / jnp.where(height_of == 0, 1.0, height_of)
    along, length = ray @ view.centre, (ray * ray).sum(-1)
    beyond = view.centre @ view.centre - view.radius**2
    inside = along**2 - length * beyond
    # At the outline itself the line is the outline, whose derivative is elsewhere.
    depth = along - jnp.sqrt(jnp.where(inside > 0, inside, 1.0))
    of_light = length / jnp.where(depth > 0, depth, 1.0)
    return jnp.where(face < 0, jnp.where(inside > 0, of_light, 0.0), of_plane)


def _room(size: tuple[int, int]) -> tuple[int, int]:
    """How many fragments, and how many lines of intersection, a picture has room for."""
    pixels = size[0] * size[1]
    return FRAGMENTS + pixels // 4, CROSSINGS + pixels // 8


def _lens(size: tuple[int, int], near: float, far: float, focal: float):
    from godfit.scenes.projection import Lens

    height, width = size
    return Lens(
        0.5 * height * focal, 0.5 * height * focal, 0.5 * width, 0.5 * height, near, far
    )  # fmt: skip


def _drawn(size, near, far, view):
    """Triangles, cuts, lens and labels of a view, in float64."""
    from godfit.scenes import projection, visibility

    vertices, faces, face_label, edges, centre, radius, focal = (np.asarray(z) for z in view)
    vertices, centre = vertices.astype(np.float64), centre.astype(np.float64)
    if not -centre[2] > near:
        raise InputError(
            "light: expected it before the camera, got a place behind it, where its rays would be "
            "mirrored; move the camera or the light"
        )
    lens = _lens(size, near, far, float(focal))
    triangles, cuts = projection.screen_triangles(vertices, faces, face_label, lens, size)
    label, q = visibility.label(triangles, lens, centre, float(radius), size)
    return vertices, edges, centre, float(radius), lens, triangles, cuts, label, q


def _visible(size, near, far, *view):
    with _one_at_a_time:
        *_, label, q = _drawn(size, near, far, view)
    dtype = np.asarray(view[0]).dtype
    with np.errstate(divide="ignore"):
        return label, (1 / q).astype(dtype)


def _contours(size, near, far, colour_of, *view):
    from godfit.scenes import contours, projection
    from godfit.scenes.intersections import may_cross

    with _one_at_a_time:
        vertices, edges, centre, radius, lens, triangles, cuts, label, _ = _drawn(
            size, near, far, view
        )
        faces, face_label = np.asarray(view[1]), np.asarray(view[2])
        outline = len(vertices) - OUTLINE
        candidates = projection.screen_edges(vertices, edges, outline, cuts, lens, size)
        colours = np.array(colour_of)
        found = contours.contours(
            triangles,
            candidates,
            label,
            colours,
            max(colour_of) + 1,
            lens,
            centre,
            radius,
            may_cross(vertices, faces, face_label, colours, centre, radius),
        )
    dtype, crossed = np.asarray(view[0]).dtype, found.crossed
    return (
        found.share.astype(dtype),
        *_filled(size, 0, found.pixel, candidates.made_of[found.edge], found.weight.astype(dtype)),
        *_filled(size, 1, crossed.pixel, crossed.faces, crossed.place.astype(dtype),
                 _given(crossed.weight, crossed.colours, max(colour_of) + 1).astype(dtype)),
    )  # fmt: skip


def _given(weight: np.ndarray, colours: np.ndarray, count: int) -> np.ndarray:
    """(n, count) what the first of two colours gains and the second loses."""
    of_colour = np.eye(count)
    return weight[:, None] * (of_colour[colours[:, 0]] - of_colour[colours[:, 1]])


def _filled(size: tuple[int, int], kind: int, *arrays: np.ndarray):
    """How many there are, and the arrays with zeros behind, as long as there is room for."""
    count, room = len(arrays[0]), _room(size)[kind]
    if count > room:
        raise InputError(
            f"scene: expected at most {room:,} pieces of contour in {size[1]}x{size[0]} pixels, "
            f"got {count:,}; simplify the mesh or enlarge the image"
        )
    whole = [np.zeros((room, *z.shape[1:]), z.dtype) for z in arrays]
    for empty, z in zip(whole, arrays, strict=True):
        empty[:count] = z
    kinds = [z if z.dtype.kind == "f" else z.astype(np.int32) for z in whole]
    return np.int32(count), *kinds
