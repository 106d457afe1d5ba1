"""Scene -> occlusion mask, anti-aliased exactly and differentiable at its contours.

Visibility is piecewise constant and has no derivative: compiled code computes it
(``visibility.py``, ``contours.py``) behind a callback. All the derivative lies in the contours (Li,
Aittala, Durand & Lehtinen, SIGGRAPH Asia 2018, section 4). As an edge's ends move on the screen,
the edge sweeps over a part of a pixel, and that part changes from the colour on one side to that on
the other. The ends are functions of the scene in JAX, so that forward and reverse mode reach
objects, camera and light. A line in which two surfaces pass through each other moves as their
depths do.

The light is a sphere. Its outline is the circle in which the cone of tangents from the camera
touches it, drawn as a polygon of equal area with OUTLINE_CORNERS corners. The inside and the depth
of the light are exact.
"""

from __future__ import annotations

import functools
import threading
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from godfit.errors import InputError
from godfit.scenes.labels import FIRST_OBJECT_LABEL
from godfit.scenes.scene import Scene

if TYPE_CHECKING:
    from godfit.scenes.projection import CameraMesh, ProjectedScene

OUTLINE_CORNERS = 512
"""Corners of the polygon for the light's outline. A light as tall as a picture of 512 rows then
lies within 1/100 pixel of its circle."""
FRAGMENT_ROOM = 1 << 16
"""Fragments of contour (one edge in one pixel) that a picture has room for, beside a quarter of its
pixels. A skull of 31,016 triangles at 512x512 has 8,000."""
CROSSING_ROOM = 1 << 15
"""Pieces of intersection lines that a picture has room for, beside an eighth of its pixels. A line
has some ten pieces in a pixel."""
FRAGMENT_PROGRAMS = (32, 8, 1)
"""The derivative is compiled for these fractions of the fragments' room (1/32, 1/8, all): most
pictures have few fragments, and need not pay for the whole room."""

_callback_lock = threading.Lock()
"""One callback at a time: each uses all cores already."""


class Visible(NamedTuple):
    """Nearest surface at the pixel centres: label (h, w), 0 background, 1 light, 2 + i occluder i;
    and depth (h, w) along the view, in the scene's unit, infinite where there is none."""

    label: Int[Array, "h w"]
    depth: Float[Array, "h w"]


def palette(scene: Scene) -> tuple[tuple[float, float, float], ...]:
    """The different colours of a scene, that of the background first."""
    return tuple(dict.fromkeys(_colour_by_label(scene)))


def rasterise(
    scene: Scene, *, antialias: bool = True, still: bool = False
) -> Float[Array, "h w"] | Float[Array, "..."]:
    """The occlusion mask of a scene: (h, w), or (h, w, 3) where a colour is not grey; row 0 at the
    top, linear.

    With ``antialias`` a pixel is the exact mean over its area, and the mask is differentiable in
    the positions, rotations and scales of the objects, the camera and the light. Without, a pixel
    has the colour of its centre, as WebGL draws it, and the derivative is zero. With ``still`` the
    derivative is zero as well, and there is less to compile.

    Raises InputError for a light that is not before the camera, and for more fragments of contour
    than ``FRAGMENT_ROOM`` and ``CROSSING_ROOM`` leave room for.

    >>> import jax, godfit
    >>> scene = godfit.read_scene("scene.toml")
    >>> jax.eval_shape(lambda: godfit.rasterise(scene)).shape
    (24, 32)
    """
    colours = np.array(palette(scene))
    grey = (colours == colours[:, :1]).all()
    values = jnp.asarray(colours[:, 0] if grey else colours, scene.light.position.dtype)
    if antialias:
        return coverage(scene, still=still) @ values
    return values[jnp.asarray(np.array(_colour_indices(scene)))[visible(scene).label]]


def visible(scene: Scene) -> Visible:
    """The nearest surface at the pixel centres. It is piecewise constant: without derivative."""
    view = _view(scene)
    dtype = scene.light.position.dtype
    shape = (
        jax.ShapeDtypeStruct(scene.size, jnp.int32),
        jax.ShapeDtypeStruct(scene.size, dtype),
    )
    label, depth = jax.pure_callback(
        functools.partial(_visible_callback, scene.size, scene.camera.near, scene.camera.far),
        shape,
        *jax.lax.stop_gradient(view),
        vmap_method="sequential",
    )
    return Visible(label, depth)


def coverage(scene: Scene, *, still: bool = False) -> Float[Array, "h w colours"]:
    """The share of every pixel that each colour of ``palette`` covers; shares sum to one. With
    ``still`` there is no derivative, and less to compile. Raises what ``rasterise`` raises."""
    height, width = scene.size
    colour_of = _colour_indices(scene)
    colours = len(palette(scene))
    fragments, pieces = _capacity(scene.size)
    dtype = scene.light.position.dtype
    view = _view(scene)
    shape = (
        jax.ShapeDtypeStruct((height, width, colours), dtype),
        jax.ShapeDtypeStruct((), jnp.int32),
        jax.ShapeDtypeStruct((fragments,), jnp.int32),
        jax.ShapeDtypeStruct((fragments, 4), jnp.int32),
        jax.ShapeDtypeStruct((fragments, colours, 4), dtype),
        jax.ShapeDtypeStruct((), jnp.int32),
        jax.ShapeDtypeStruct((pieces,), jnp.int32),
        jax.ShapeDtypeStruct((pieces, 2), jnp.int32),
        jax.ShapeDtypeStruct((pieces, 2), dtype),
        jax.ShapeDtypeStruct((pieces, colours), dtype),
    )
    share, count, pixel, made_of, weight, piece_count, *lines = jax.pure_callback(
        functools.partial(
            _contours_callback, scene.size, scene.camera.near, scene.camera.far, colour_of
        ),
        shape,
        *jax.lax.stop_gradient(view),
        vmap_method="sequential",
    )
    if still:
        return share
    share = share.reshape(-1, colours)

    def add_edge_motion(size: int, share, view):
        """Add zero, with the derivative of the first ``size`` fragments."""
        ends = [
            _screen_points(scene, view, made_of[:size, k], made_of[:size, k + 1]) for k in (0, 2)
        ]
        ends = jnp.concatenate(ends, -1)
        moved = jnp.einsum("fck,fk->fc", weight[:size], ends - jax.lax.stop_gradient(ends))
        return share.at[pixel[:size]].add(moved)

    def add_line_motion(share, view):
        """Add zero, with the derivative of the intersection lines."""
        line_pixel, faces, place, weight = lines
        one, other = (_inverse_depth(scene, view, faces[:, k], place) for k in (0, 1))
        ahead = one - other
        return share.at[line_pixel].add(weight * (ahead - jax.lax.stop_gradient(ahead))[:, None])

    sizes = [fragments // part for part in FRAGMENT_PROGRAMS]
    which = (count > sizes[0]).astype(jnp.int32) + (count > sizes[1])
    programs = [functools.partial(add_edge_motion, n) for n in sizes]
    share = jax.lax.switch(which, programs, share, view)
    if scene.occluders:
        share = jax.lax.cond(piece_count > 0, add_line_motion, lambda share, _: share, share, view)
    return share.reshape(height, width, colours)


def on_screen(scene: Scene) -> Float[Array, "2"]:
    """Texture coordinates (u, v) of the light's centre, on the screen or off it. The light must lie
    before the camera: the rays of one behind it would be mirrored."""
    x, y, z = scene.camera_axes() @ (scene.light.position - scene.camera.position)
    focal = _focal_length(scene)
    aspect = scene.size[1] / scene.size[0]
    return jnp.stack([0.5 + 0.5 * focal / aspect * x / -z, 0.5 + 0.5 * focal * y / -z])


class _View(NamedTuple):
    """Arguments of the callbacks: the vertices in camera space, those of the light's outline last;
    faces, the label of each, and edges as in ``mesh.edges``; the light's centre in camera space and
    its radius; the focal length in half heights of the picture; and which faces are drawn only
    where they are counter-clockwise."""

    vertices: Float[Array, "v 3"]
    faces: Int[Array, "f 3"]
    face_label: Int[Array, " f"]
    edges: Int[Array, "e 4"]
    centre: Float[Array, "3"]
    radius: Float[Array, ""]
    focal: Float[Array, ""]
    single_sided: Bool[Array, " f"]


def _colour_by_label(scene: Scene):
    return [scene.background, scene.light.colour, *(obj.colour for obj in scene.occluders)]


def _colour_indices(scene: Scene) -> tuple[int, ...]:
    """The place in ``palette`` of each label's colour."""
    colours = palette(scene)
    return tuple(colours.index(c) for c in _colour_by_label(scene))


def _focal_length(scene: Scene) -> Float[Array, ""]:
    """The focal length in half heights of the picture."""
    return 1 / jnp.tan(jnp.deg2rad(scene.camera.fov_y) / 2)


def _view(scene: Scene) -> _View:
    rotation = scene.camera_axes()

    def to_camera(points):
        return (points - scene.camera.position[None]) @ rotation.T

    centre = to_camera(scene.light.position[None])[0]
    vertices, faces, labels, edges, single, first = [], [], [], [], [], 0
    for i, obj in enumerate(scene.occluders):
        vertices.append(to_camera(obj.world()))
        faces.append(obj.faces + first)
        # -1 is no vertex.
        edges.append(jnp.where(obj.edges < 0, obj.edges, obj.edges + first))
        labels.append(jnp.full(obj.faces.shape[0], FIRST_OBJECT_LABEL + i, jnp.int32))
        both = obj.single_sided is None
        single.append(jnp.zeros(obj.faces.shape[0], bool) if both else obj.single_sided)
        first += obj.vertices.shape[0]
    vertices.append(_outline(centre, scene.light.radius))
    none = jnp.zeros((0, 3), jnp.int32), jnp.zeros(0, jnp.int32), jnp.zeros((0, 4), jnp.int32)
    return _View(
        jnp.concatenate(vertices),
        jnp.concatenate([none[0], *faces]),
        jnp.concatenate([none[1], *labels]),
        jnp.concatenate([none[2], *edges]),
        centre,
        scene.light.radius,
        _focal_length(scene),
        jnp.concatenate([jnp.zeros(0, bool), *single]),
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
    turn = 2 * np.pi / OUTLINE_CORNERS
    # The corners lie a little outside the circle, so that the polygon has its area.
    size = radius * jnp.sqrt(jnp.maximum(1 - share, 0)) * np.sqrt(turn / np.sin(turn))
    angle = np.arange(OUTLINE_CORNERS) * turn
    circle = jnp.asarray(np.cos(angle), centre.dtype)[:, None] * across[None]
    circle = circle + jnp.asarray(np.sin(angle), centre.dtype)[:, None] * up[None]
    return centre[None] * (1 - share) + size * circle


def _screen_points(scene: Scene, view: _View, i: Int[Array, " f"], j: Int[Array, " f"]):
    """(f, 2) x and y in pixels of the points made of vertices i and j: see ``projection.Edges``."""
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
    # At the outline the line is an edge, whose fragments have the derivative.
    depth = along - jnp.sqrt(jnp.where(inside > 0, inside, 1.0))
    of_light = length / jnp.where(depth > 0, depth, 1.0)
    return jnp.where(face < 0, jnp.where(inside > 0, of_light, 0.0), of_plane)


def _capacity(size: tuple[int, int]) -> tuple[int, int]:
    """The number of fragments, and of pieces of intersection lines, that a picture has room for."""
    pixels = size[0] * size[1]
    return FRAGMENT_ROOM + pixels // 4, CROSSING_ROOM + pixels // 8


class _Drawing(NamedTuple):
    """A view in float64, projected, with the z-buffer at the pixel centres."""

    mesh: CameraMesh
    scene: ProjectedScene
    cuts: np.ndarray
    label: np.ndarray
    q: np.ndarray


def _draw(size: tuple[int, int], near: float, far: float, view: _View) -> _Drawing:
    """Project a view, and label its pixels."""
    # numba takes long to import, and not every command draws a scene.
    from godfit.scenes import projection, visibility

    vertices, faces, face_label, _, centre, radius, focal, single = map(np.asarray, view)
    sphere = projection.Sphere(centre.astype(np.float64), float(radius))
    if not -sphere.centre[2] > near:
        raise InputError(
            "light: expected it before the camera, got a place behind it, where its rays would be "
            "mirrored; move the camera or the light"
        )
    lens = projection.lens_of(size, float(focal), near, far)
    mesh = projection.CameraMesh(vertices.astype(np.float64), faces, face_label, single)
    triangles, cuts = projection.screen_triangles(mesh, lens, size)
    scene = projection.ProjectedScene(triangles, sphere, lens)
    return _Drawing(mesh, scene, cuts, *visibility.label_pixels(scene, size))


def _visible_callback(size, near, far, *view):
    with _callback_lock:
        drawing = _draw(size, near, far, _View(*view))
    dtype = np.asarray(view[0]).dtype
    with np.errstate(divide="ignore"):
        return drawing.label, (1 / drawing.q).astype(dtype)


def _contours_callback(size, near, far, colour_of, *view):
    from godfit.scenes.contours import contours
    from godfit.scenes.intersections import may_cross
    from godfit.scenes.projection import EdgeSources, screen_edges

    with _callback_lock:
        drawing = _draw(size, near, far, _View(*view))
        mesh, scene, colours = drawing.mesh, drawing.scene, np.array(colour_of)
        outline = len(mesh.vertices) - OUTLINE_CORNERS
        sources = EdgeSources(mesh.vertices, np.asarray(view[3]), outline, drawing.cuts)
        edges = screen_edges(sources, scene.lens, size)
        crossing = may_cross(mesh, scene.sphere, colours)
        found = contours(scene, edges, drawing.label, colours, crossing)
    dtype, crossings = np.asarray(view[0]).dtype, found.crossings
    exchange = _colour_exchange(crossings.weight, crossings.colours, max(colour_of) + 1)
    fragments, pieces = _capacity(size)
    return (
        found.share.astype(dtype),
        *_padded(size, fragments, found.pixel, edges.made_of[found.edge],
                 found.weight.astype(dtype)),
        *_padded(size, pieces, crossings.pixel, crossings.faces, crossings.place.astype(dtype),
                 exchange.astype(dtype)),
    )  # fmt: skip


def _colour_exchange(weight: np.ndarray, colours: np.ndarray, count: int) -> np.ndarray:
    """(n, count) the gain of the first of two colours (n, 2), which is the loss of the second."""
    of_colour = np.eye(count)
    return weight[:, None] * (of_colour[colours[:, 0]] - of_colour[colours[:, 1]])


def _padded(size: tuple[int, int], room: int, *arrays: np.ndarray):
    """The length of the arrays, and the arrays padded with zeros to ``room``. Raises InputError
    where they are longer."""
    count = len(arrays[0])
    if count > room:
        raise InputError(
            f"scene: expected at most {room:,} pieces of contour in {size[1]}x{size[0]} pixels, "
            f"got {count:,}; simplify the mesh or enlarge the image"
        )
    padded = [np.zeros((room, *z.shape[1:]), z.dtype) for z in arrays]
    for whole, z in zip(padded, arrays, strict=True):
        whole[:count] = z
    return np.int32(count), *(z if z.dtype.kind == "f" else z.astype(np.int32) for z in padded)
