"""Starting points for a fit, from a coarse look at a small copy of the images.

On a copy of at most 64 pixels, every combination of a grid of lights, attenuations and densities is
tried; exposure and gain enter the sum linearly and are solved for exactly (variable projection:
Golub & Pereyra, SIAM J. Numer. Anal. 10 (1973), 413). The rays of one light are read once and
shared by all attenuations and densities, which are weights along them.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from scipy import ndimage

from godfit.inference.observation import Picture
from godfit.inference.strategy import starts, trading
from godfit.inference.variable_projection import nonnegative_two
from godfit.io.filters import grey, shrink
from godfit.io.image import LEVELS, decode
from godfit.models.mitchell import Mitchell
from godfit.runtime.device import on_device
from godfit.runtime.parallel import map_halves
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.radial.nearest import GRID_DENSITIES, RAY_STEPS, read_rays

SIZE = 64
POINTS = 512
# Groups of lights that are grown by one more light.
GROUPS = 48
# Lights drawn where it is bright: so many that all lights are an even number.
SPOTS = 65
KAPPAS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.5, 7.0, 11.0, 18.0, 30.0)


def light_grid(target: np.ndarray, seed: int) -> np.ndarray:
    """(lights, 2): a lattice over the image, rings around it, farther apart the farther out, and
    places drawn where the small ``target`` is bright."""
    inside = np.linspace(0.0, 1.0, 13)
    lattice = np.array(list(itertools.product(inside, inside)))
    angle = np.arange(16) * np.pi / 8
    circle = 0.5 * np.stack([np.cos(angle), np.sin(angle)], -1)
    rings = np.concatenate([0.5 + circle * r for r in (1.3, 1.6, 2.0, 3.0, 4.5, 7.0)])
    rings = rings[(np.abs(rings - 0.5) > 0.51).any(1)]
    h, w = target.shape
    bright = np.maximum(target, 0).ravel().astype(np.float64) ** 2 + 1e-12
    rng = np.random.default_rng(seed)
    drawn = rng.choice(h * w, min(SPOTS, h * w), replace=False, p=bright / bright.sum())
    spots = np.stack([(drawn % w + 0.5) / w, 1 - (drawn // w + 0.5) / h], -1)
    return np.concatenate([lattice, rings, spots])


@cached_jit
def _box_rays(
    mask: Float[Array, "h w"],
    light: Float[Array, "lights 2"],
    at: Float[Array, "points 2"],
    model: Mitchell,
) -> Float[Array, "lights 1 points"]:
    """The light pass of exposure 1 for every light, for a shader without shapes to share."""
    model = eqx.tree_at(lambda m: m.exposure, model, jnp.ones_like(model.exposure))

    def one(light):
        lit = eqx.tree_at(lambda m: m.light, model, light[None])
        return lit.light_pass(mask, at)[None]

    return lax.map(one, light)


class _View(NamedTuple):
    """The points (n,) of the small copy that are compared: the mask at the pixel itself, the light
    pass of the target, and whether that counts."""

    own: np.ndarray
    target: np.ndarray
    weight: np.ndarray


@cached_jit
def _solve(rays, shapes, view):
    """Exposure and gain, neither negative, and the cost, for every light and shape.

    ``rays`` (lights, steps, points), ``shapes`` (shapes, steps); ``view`` as in ``_View``.
    """
    own, target, weight = view

    def one(rays):
        s = shapes @ rays
        wt, wo = weight * target, weight * own
        products, squares = (wt @ own, s @ wt), (wo @ own, (s * s) @ weight)
        return nonnegative_two(wt @ target, products, squares, s @ wo)

    return lax.map(one, rays)


@starts.register
def mitchell_starts(
    model: Mitchell, picture: Picture, given: dict[str, float], *, keep: int, seed: int
) -> list[np.ndarray]:
    """The ``keep`` best starting points in the model's coordinates, best first.

    Parameters in ``given`` are taken as they are and not searched for. The lights are placed one
    after the other, each where it helps most (matching pursuit).
    """
    shader, lights = model.convention, model.light.shape[0]
    if given.keys() >= model.parameters.keys():
        return [_with_given(model, np.asarray(model.coordinates(), np.float32), given)]
    target, weight = _light_pass(picture, model)
    mask = shrink(grey(picture.mask), (SIZE, SIZE))
    h, w = target.shape
    chosen = np.random.default_rng(seed).permutation(h * w)[:POINTS]
    at = np.stack(
        [
            (chosen % w + 0.5) * mask.shape[1] / w - 0.5,
            (chosen // w + 0.5) * mask.shape[0] / h - 0.5,
        ],
        -1,
    ).astype(np.float32)
    goal, trust = (z.ravel()[chosen].astype(np.float32) for z in (target, weight))
    places, told = places_for(light_grid(target, seed), given, lights)
    if shader.box:
        shapes, along, scale, own = np.ones((1, 2)), np.ones((1, 1), np.float32), 1.0, 0 * goal

        def read(spots):
            return _box_rays(on_device(mask), on_device(spots), on_device(at), model)
    else:
        shapes = _shapes(given, model.samples)
        middles = (np.arange(RAY_STEPS) + 0.5) / RAY_STEPS
        # The last step of a ray may be covered in part.
        part = np.clip(shapes[:, 1:] * RAY_STEPS - np.arange(RAY_STEPS), 0, 1)
        along = (np.exp(-shapes[:, :1] * middles) * part / RAY_STEPS).astype(np.float32)
        scale = shader.gain
        own = ndimage.map_coordinates(mask, at[:, ::-1].T, order=1, mode="nearest")
        own = own * np.float32(lights * shader.own)
        fine = ndimage.zoom(mask, 2, order=1, mode="nearest", grid_mode=True)

        def read(spots):
            return read_rays(on_device(fine), on_device(spots), on_device(at))

    view = _View(own, goal, trust)
    groups = np.arange(len(places))[:, None]
    if lights > 1:
        rays, required = read(places), tuple(range(len(told)))
        groups = _best_groups(rays, along, view, lights, required)
        groups = np.array([_in_order(group, places, told) for group in groups])
        rays = rays[jnp.asarray(groups)].sum(1)
        e, g, cost = (np.asarray(z) for z in _solve(rays, along, view))
    else:
        e, g, cost = map_halves(lambda spots: _solve(read(spots), along, view), places)
    spots = places[groups].reshape(len(groups), -1)
    found = []
    for i, j in apart(cost, spots, shapes, keep):
        exposure, gain = e[i, j] / scale, g[i, j] / scale
        if shader.box:
            exposure, gain = gain, 1.0
        elif not shader.own_pixel:
            exposure = shader.defaults["exposure"]
        # An exposure of zero would leave the weight without meaning.
        exposure = max(exposure, 1e-2 * gain / model.samples, 1e-4)
        start = np.array([exposure, *shapes[j], max(gain, 1e-4), *spots[i]], np.float32)
        found.append(_with_given(model, start, given))
    return found


@trading.register
def _(model: Mitchell) -> tuple[str, ...]:
    return "exposure", "decay"


def _with_given(model: Mitchell, start: np.ndarray, given: dict[str, float]) -> np.ndarray:
    """``start`` with the given parameters put in."""
    if not given:
        return start
    held = np.array([given.get(name, np.nan) for name in model.parameters], np.float32)
    # decay and weight are coordinates of their own only together with density and exposure, so the
    # given ones go in as parameters and come out as coordinates.
    at = model.moved(jnp.asarray(start), held)
    decay = jnp.maximum(at.decay, 1e-6)
    return np.asarray(eqx.tree_at(lambda m: m.decay, at, decay).coordinates(), np.float32)


def _in_order(group: np.ndarray, places: np.ndarray, told: tuple[int, ...]) -> list[int]:
    """The lights of a group, first the ``told`` ones, in the order of the parameters: those where
    they were given, the others from left to right."""
    indices: list[int] = group.tolist()
    first = dict(zip(told, indices, strict=False))
    rest = sorted(indices[len(told) :], key=lambda i: tuple(places[i]))
    return [first[i] if i in first else rest.pop(0) for i in range(len(indices))]


def _light_pass(picture: Picture, model: Mitchell) -> tuple[np.ndarray, np.ndarray]:
    """Small copies of the light pass, background taken off, and of where it can be trusted."""
    shader = model.convention
    light = np.asarray(decode(picture.levels / np.float32(LEVELS), picture.transfer))
    if picture.background is not None:
        back = picture.background
        if shader.blend == "screen":
            light = (light - back) / np.maximum(1 - back, 0.05)
        else:
            light = light - np.float32(shader.background_gain) * back
    trust = shrink((picture.valid & ~picture.clipped).astype(np.float32), (SIZE, SIZE))
    return shrink(light.mean(-1), (SIZE, SIZE)), (trust > 0.99).astype(np.float32)


def places_for(
    places: np.ndarray, given: dict[str, float], lights: int
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Candidate places for a light, and which lights are told: their places come first."""
    required: list[np.ndarray] = []
    told: list[int] = []
    for i in range(lights):
        stem = "light" if i == 0 else f"light{i + 1}"
        u, v = given.get(f"{stem}_x"), given.get(f"{stem}_y")
        if u is not None and v is not None:
            required.append(np.array([u, v]))
            told.append(i)
        elif lights == 1 and u is not None:
            places = np.stack([np.full(len(places), u), places[:, 1]], -1)
        elif lights == 1 and v is not None:
            places = np.stack([places[:, 0], np.full(len(places), v)], -1)
    if len(required) == lights:
        places = np.array(required)
    elif required:
        places = np.concatenate([required, places])
    return places.astype(np.float32), tuple(told)


def _shapes(given: dict[str, float], samples: int) -> np.ndarray:
    """(shapes, 2) pairs of kappa and density."""
    densities = (given["density"],) if "density" in given else GRID_DENSITIES
    pairs = []
    for density in densities:
        kappas: tuple[float, ...] = KAPPAS
        if "decay" in given:
            kappas = (-samples * float(np.log(max(given["decay"], 1e-6))) / max(density, 1e-3),)
        pairs += [(kappa, density) for kappa in kappas]
    return np.array(pairs, np.float32)


def apart(
    cost: np.ndarray, places: np.ndarray, shapes: np.ndarray, keep: int
) -> list[tuple[int, int]]:
    """Indices (place, shape) of the ``keep`` cheapest starts that are not neighbours of a cheaper
    one."""
    left, kept = cost.astype(np.float64), []
    while len(kept) < keep:
        i, j = divmod(int(left.argmin()), left.shape[1])
        if not left[i, j] < np.inf:
            break
        kept.append((i, j))
        near = np.abs(places - places[i]).max(1) < 0.2
        alike = np.abs(shapes[:, 1] - shapes[j, 1]) < 0.25
        left[np.ix_(near, alike)] = np.inf
    return kept


def _best_groups(rays, along, view, lights, required):
    """Groups of lights, grown one light at a time from the cheapest."""
    start = [required]
    for size in range(len(required) + 1, lights + 1):
        grown = sorted({(*g, i) for g in start for i in range(len(rays)) if i not in g})
        grown = list({frozenset(g): g for g in grown}.values())
        costs = []
        scaled = view._replace(own=view.own * size / lights)
        for batch in range(0, len(grown), 256):
            index = np.array(grown[batch : batch + 256])
            costs.append(np.asarray(_solve(rays[index].sum(1), along, scaled)[2]).min(1))
        order = np.argsort(np.concatenate(costs))[:GROUPS]
        start = [grown[i] for i in order]
    return np.array(start)
