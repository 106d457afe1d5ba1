"""Starting points for a fit, from a coarse screening on a small copy of the images.

The copy has at most 64 pixels a side. Every combination of a grid of lights, attenuations and
densities is evaluated. Exposure and gain enter the sum linearly and are solved for exactly
(variable projection: Golub & Pereyra, SIAM J. Numer. Anal. 10 (1973), 413). The mask along the rays
of one light is read once and shared by all attenuations and densities, which are weights along
them.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from godfit.inference.observation import Picture
from godfit.inference.strategy import starts, trading
from godfit.inference.variable_projection import nonnegative_two
from godfit.io.filters import doubled, grey, read_at, shrink
from godfit.io.image import LEVELS, decode
from godfit.models.coordinates import EXPOSURE, GAIN
from godfit.models.mitchell import Mitchell
from godfit.models.tinted import TINT_PARAMETERS, Tinted
from godfit.runtime.device import on_device
from godfit.runtime.parallel import map_halves
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.parameters import density_reach
from godfit.scattering.radial.nearest import GRID_DENSITIES, RAY_STEPS, read_rays

SCREENING_SIZE = 64
"""Pixels a side of the small copy: rays are smooth enough for it."""
SCREENING_POINTS = 512
"""Pixels of the copy that are compared: they limit the time."""
LIGHT_GROUPS = 48
"""Groups of lights, the best ones, that are extended by one more light."""
BRIGHT_PLACES = 65
"""Lights drawn where the target is bright: with these the number of lights is even, and halves."""
BRIGHT_FLOOR = 1e-12
"""Weight of a black pixel in that draw: each must have some."""
SCREENED_KAPPAS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.5, 7.0, 11.0, 18.0, 30.0)
"""Attenuations along the whole ray that are tried, closer together where they matter most."""
TRUSTED_SHARE = 0.99
"""Share of a cell's pixels that must be valid and not clipped for the cell to count."""
NEIGHBOUR_PLACE = 0.2
"""Distance of two lights, in pictures, within which a start is a neighbour of another."""
NEIGHBOUR_DENSITY = 0.25
"""Difference of two densities within which a start is a neighbour of another."""
TINY_POWER = 1e-12
"""Least squared light of green that a tint is relative to: a target may be black there."""
LEAST_TINT = 1e-3
"""Least red or blue of a start: from 0 a channel would have no slope."""
GROUP_BATCH = 256
"""Groups that are solved at once, so that memory does not grow with their number."""


def light_grid(target: np.ndarray, seed: int) -> np.ndarray:
    """(lights, 2) places (u, v): a lattice over the image, rings around it that are farther apart
    the farther out they are, and places drawn where the small ``target`` (h, w) is bright."""
    inside = np.linspace(0.0, 1.0, 13)
    lattice = np.array(list(itertools.product(inside, inside)))
    angle = np.arange(16) * np.pi / 8
    circle = 0.5 * np.stack([np.cos(angle), np.sin(angle)], -1)
    rings = np.concatenate([0.5 + circle * r for r in (1.3, 1.6, 2.0, 3.0, 4.5, 7.0)])
    rings = rings[(np.abs(rings - 0.5) > 0.51).any(1)]
    h, w = target.shape
    bright = np.maximum(target, 0).ravel().astype(np.float64) ** 2 + BRIGHT_FLOOR
    rng = np.random.default_rng(seed)
    drawn = rng.choice(h * w, min(BRIGHT_PLACES, h * w), replace=False, p=bright / bright.sum())
    spots = np.stack([(drawn % w + 0.5) / w, 1 - (drawn // w + 0.5) / h], -1)
    return np.concatenate([lattice, rings, spots])


LEAST_BLENDED = 0.05
"""Least factor of a light pass in its blend that is divided by."""
WHOLE_SHAPES = 12
"""Attenuations and densities at which a shader is screened whose rays cannot be shared."""


@cached_jit
def _whole_rays(
    mask: Float[Array, "h w"],
    light: Float[Array, "lights 2"],
    at: Float[Array, "points 2"],
    shapes: Float[Array, "shapes 2"],
    model: Mitchell,
) -> Float[Array, "lights shapes points"]:
    """The light pass of exposure 1 for every light and shape, for a shader whose rays cannot be
    shared: by the mask as it is, which a threshold may have cut."""
    ones = jnp.ones_like(model.exposure)

    def one(light, shape):
        kappa, density = shape[0], shape[1]
        decay = jnp.exp(-kappa * density / model.samples)
        lit = eqx.tree_at(
            lambda m: (m.exposure, m.decay, m.density, m.weight, m.light),
            model,
            (ones, decay, density, ones, light[None]),
        )
        return lit.light_pass(mask, at)

    def every(light):
        return lax.map(lambda shape: one(light, shape), shapes)

    return lax.map(every, light)


def _alone(model: Mitchell) -> bool:
    """Whether rays of this shader cannot be shared by several attenuations and densities."""
    return model.convention.composed or model.convention.power != 1


def _whole_shapes(given: dict[str, float], model: Mitchell) -> np.ndarray:
    """(shapes, 2) pairs of kappa and density that a shader is screened at whose rays cannot be
    shared: few, as every pair costs a picture."""
    shader = model.convention
    if shader.box:
        return np.ones((1, 2), np.float32)
    known = {n: v for n, v in shader.absent.items() if n in ("decay", "density")} | given
    found = _shapes(known, model.samples)
    if "density" in known or shader.passes or shader.blurs:
        return found
    return found[:: max(1, len(found) // WHOLE_SHAPES)]


def _linear_start(
    model: Mitchell, solved: tuple[float, float], shape: np.ndarray
) -> tuple[float, float]:
    """The coordinates exposure and gain from the factors ``solved`` of the pixel's own value and
    of the integral along the ray, at a ``shape`` (kappa, density)."""
    shader, (own, along) = model.convention, solved
    n, density = int(model.samples), float(shape[1])
    if _alone(model):
        return along, 1.0
    scale = shader.gain / (n if shader.averaged else 1)
    exposure, gain = own / scale, along / scale
    if "weight" in shader.absent:
        # One number scales both: that of the rays, of which there are more.
        exposure = gain * density / (n * shader.absent["weight"])
        if shader.saturated:
            decay = math.exp(-float(shape[0]) * density / n)
            total = float(shader.weights(decay, shader.count(n)))
            room = max(1 - exposure * total, LEAST_BLENDED)
            exposure *= (1 - shader.threshold) / room
    elif not shader.own_pixel:
        exposure = shader.defaults.get("exposure", 1.0)
    return exposure, gain


class _View(NamedTuple):
    """The points (n,) of the small copy that are compared: the mask at the pixel itself, the light
    pass of the target, and the weight, 1 or 0, of the point."""

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

    Parameters in ``given`` are held at their values. The lights are placed one after the other,
    each where it lowers the cost most (matching pursuit).
    """
    shader, lights = model.convention, model.light.shape[0]
    if given.keys() >= model.parameters.keys():
        return [_with_given(model, np.asarray(model.coordinates(), np.float32), given)]
    target, weight = _light_pass(picture, model)
    read = np.asarray(shader.reads(picture.mask))
    mask = shrink(grey(picture.mask if _alone(model) else read), (SCREENING_SIZE, SCREENING_SIZE))
    h, w = target.shape
    chosen = np.random.default_rng(seed).permutation(h * w)[:SCREENING_POINTS]
    at = np.stack(
        [
            (chosen % w + 0.5) * mask.shape[1] / w - 0.5,
            (chosen // w + 0.5) * mask.shape[0] / h - 0.5,
        ],
        -1,
    ).astype(np.float32)
    goal, weight = (z.ravel()[chosen].astype(np.float32) for z in (target, weight))
    places, given_lights = light_places(light_grid(target, seed), given, lights)
    if _alone(model):
        shapes, own = _whole_shapes(given, model), 0 * goal
        small = model.on_copy(mask.shape[0] / picture.mask.shape[0])

        def rays_to(spots):
            at_once = on_device(mask), on_device(spots), on_device(at), on_device(shapes)
            return _whole_rays(*at_once, small)

        along = np.eye(len(shapes), dtype=np.float32)
    else:
        shapes = _shapes(given, model.samples)
        steps = round(RAY_STEPS * density_reach(float(shapes[:, 1].max())))
        middles = (np.arange(steps) + 0.5) / RAY_STEPS
        # The last step of a ray may be covered in part.
        part = np.clip(shapes[:, 1:] * RAY_STEPS - np.arange(steps), 0, 1)
        along = (np.exp(-shapes[:, :1] * middles) * part / RAY_STEPS).astype(np.float32)
        own = read_at(mask, at)
        own = own * np.float32(lights * shader.own)
        if not shader.own_scaled:
            # A pixel's own value with a known factor leaves the rest to be explained.
            goal, own = goal - own, 0 * own
        fine = doubled(mask)

        def rays_to(spots):
            return read_rays(on_device(fine), on_device(spots), on_device(at), steps)

    view = _View(own, goal, weight)
    groups = np.arange(len(places))[:, None]
    if lights > 1:
        rays, required = rays_to(places), tuple(range(len(given_lights)))
        groups = _best_groups(rays, along, view, lights, required)
        groups = np.array([_in_order(group, places, given_lights) for group in groups])
        rays = rays[jnp.asarray(groups)].sum(1)
        e, g, cost = (np.asarray(z) for z in _solve(rays, along, view))
    else:
        e, g, cost = map_halves(lambda spots: _solve(rays_to(spots), along, view), places)
    spots = places[groups].reshape(len(groups), -1)
    found = []
    for i, j in distinct_starts(cost, spots, shapes, keep):
        exposure, gain = _linear_start(model, (float(e[i, j]), float(g[i, j])), shapes[j])
        # An exposure of zero would leave the weight without meaning.
        exposure = max(exposure, 1e-2 * gain / model.samples, 1e-4)
        start = np.array([exposure, *shapes[j], max(gain, 1e-4), *spots[i]], np.float32)
        found.append(_with_given(model, start, given))
    return found


@trading.register
def _(model: Mitchell) -> tuple[str, ...]:
    return "exposure", "decay"


@starts.register
def tinted_starts(
    model: Tinted, picture: Picture, given: dict[str, float], *, keep: int, seed: int
) -> list[np.ndarray]:
    """The starting points of the sum without colour, with the target's colour as the tint."""
    of_sum = {name: value for name, value in given.items() if name in model.shading.parameters}
    grey_starts = mitchell_starts(model.shading, picture, of_sum, keep=keep, seed=seed)
    light = np.asarray(decode(picture.levels / np.float32(LEVELS), picture.transfer), np.float64)
    if picture.background is not None:
        light = light - np.float32(model.convention.background_gain) * picture.background
    light = light[picture.valid & ~picture.clipped]
    power = max(float((light[:, 1] ** 2).sum()), TINY_POWER)
    tint = np.maximum((light * light[:, 1:2]).sum(0) / power, LEAST_TINT)
    # The sum is fitted to the mean of the channels, and its exposure is that of green.
    green = 3 / (tint[0] + 1 + tint[2])
    own = zip(TINT_PARAMETERS, tint[[0, 2]].tolist(), strict=True)
    ends = np.array([given.get(row.name, t) for row, t in own])
    found = [np.append(start, ends).astype(np.float32) for start in grey_starts]
    for start in found:
        start[[EXPOSURE, GAIN]] *= np.float32(green)
    return found


@trading.register
def _(model: Tinted) -> tuple[str, ...]:
    return trading(model.shading)


def _with_given(model: Mitchell, start: np.ndarray, given: dict[str, float]) -> np.ndarray:
    """``start`` with the given parameters put in."""
    if not given:
        return start
    held = np.array([given.get(name, np.nan) for name in model.parameters], np.float32)
    return np.asarray(_coordinates_with(model, jnp.asarray(start), jnp.asarray(held)), np.float32)


@cached_jit
def _coordinates_with(
    model: Mitchell, start: Float[Array, " p"], held: Float[Array, " p"]
) -> Float[Array, " p"]:
    # The coordinates of decay and weight also depend on density and exposure. So the given values
    # are put in as parameters, and the coordinates are computed from these.
    at = model.moved(start, held)
    decay = jnp.maximum(at.decay, 1e-6)
    return eqx.tree_at(lambda m: m.decay, at, decay).coordinates()


def _in_order(group: np.ndarray, places: np.ndarray, given_lights: tuple[int, ...]) -> list[int]:
    """Indices of a group's lights in the order of the parameters: those in ``given_lights`` at
    their own index, the others from left to right. In ``group`` the given ones come first."""
    indices: list[int] = group.tolist()
    first = dict(zip(given_lights, indices, strict=False))
    rest = sorted(indices[len(given_lights) :], key=lambda i: tuple(places[i]))
    return [first[i] if i in first else rest.pop(0) for i in range(len(indices))]


def _light_pass(picture: Picture, model: Mitchell) -> tuple[np.ndarray, np.ndarray]:
    """Small copies (h, w) of the light pass, background subtracted, and of the weights, 1 or 0."""
    shader = model.convention
    light = np.asarray(decode(picture.levels / np.float32(LEVELS), picture.transfer))
    if picture.background is not None:
        back = picture.background
        if shader.blend == "screen":
            light = (light - back) / np.maximum(1 - back, LEAST_BLENDED)
        elif shader.blend == "modulate":
            light = light / np.maximum(back, LEAST_BLENDED) - 1
        else:
            light = light - np.float32(shader.background_gain) * back
    weight = shrink(
        (picture.valid & ~picture.clipped).astype(np.float32), (SCREENING_SIZE, SCREENING_SIZE)
    )
    return shrink(light.mean(-1), (SCREENING_SIZE, SCREENING_SIZE)), (
        weight > TRUSTED_SHARE
    ).astype(np.float32)


def light_places(
    places: np.ndarray, given: dict[str, float], lights: int
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Candidate places (n, 2) for a light, and the indices of the lights that are given, whose
    places come first."""
    required: list[np.ndarray] = []
    given_lights: list[int] = []
    for i in range(lights):
        stem = "light" if i == 0 else f"light{i + 1}"
        u, v = given.get(f"{stem}_x"), given.get(f"{stem}_y")
        if u is not None and v is not None:
            required.append(np.array([u, v]))
            given_lights.append(i)
        elif lights == 1 and u is not None:
            places = np.stack([np.full(len(places), u), places[:, 1]], -1)
        elif lights == 1 and v is not None:
            places = np.stack([places[:, 0], np.full(len(places), v)], -1)
    if len(required) == lights:
        places = np.array(required)
    elif required:
        places = np.concatenate([required, places])
    return places.astype(np.float32), tuple(given_lights)


def _shapes(given: dict[str, float], samples: int) -> np.ndarray:
    """(shapes, 2) pairs of kappa and density."""
    densities = (given["density"],) if "density" in given else GRID_DENSITIES
    pairs = []
    for density in densities:
        kappas: tuple[float, ...] = SCREENED_KAPPAS
        if "decay" in given:
            kappas = (-samples * float(np.log(max(given["decay"], 1e-6))) / max(density, 1e-3),)
        pairs += [(kappa, density) for kappa in kappas]
    return np.array(pairs, np.float32)


def distinct_starts(
    cost: np.ndarray, places: np.ndarray, shapes: np.ndarray, keep: int
) -> list[tuple[int, int]]:
    """Indices (place, shape) of the ``keep`` cheapest starts that are not neighbours of a cheaper
    one."""
    remaining, chosen = cost.astype(np.float64), []
    while len(chosen) < keep:
        i, j = divmod(int(remaining.argmin()), remaining.shape[1])
        if not remaining[i, j] < np.inf:
            break
        chosen.append((i, j))
        near = np.abs(places - places[i]).max(1) < NEIGHBOUR_PLACE
        alike = np.abs(shapes[:, 1] - shapes[j, 1]) < NEIGHBOUR_DENSITY
        remaining[np.ix_(near, alike)] = np.inf
    return chosen


def _best_groups(rays, along, view, lights, required):
    """(groups, lights) indices of the best groups of lights, grown by one light at a time."""
    start = [required]
    for size in range(len(required) + 1, lights + 1):
        grown = sorted({(*g, i) for g in start for i in range(len(rays)) if i not in g})
        grown = list({frozenset(g): g for g in grown}.values())
        costs = []
        scaled = view._replace(own=view.own * size / lights)
        for batch in range(0, len(grown), GROUP_BATCH):
            index = np.array(grown[batch : batch + GROUP_BATCH])
            costs.append(np.asarray(_solve(rays[index].sum(1), along, scaled)[2]).min(1))
        order = np.argsort(np.concatenate(costs))[:LIGHT_GROUPS]
        start = [grown[i] for i in order]
    return np.array(start)
