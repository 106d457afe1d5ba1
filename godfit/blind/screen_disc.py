"""Starting points for a picture that comes with nothing: where the light is, and how large.

Rays point away from the light: along a ray's edge the picture changes across it, around a glow it
changes towards the middle. Every pixel's gradient votes for the lights that its ray or its glow
may come from; bright compact regions and a lattice add others. For each, discs of several radii
under several attenuations and densities are tried on a copy of at most 64 pixels, everything that
the picture is linear in solved for (variable projection, as in ``screen.py``).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from scipy import ndimage

from godfit.blind.consensus import votes_for
from godfit.blind.segment import regions
from godfit.errors import InputError
from godfit.inference.observation import Picture
from godfit.io.filters import shrink
from godfit.io.image import LEVELS
from godfit.models.background import term_values
from godfit.runtime.device import on_device
from godfit.runtime.parallel import map_halves, parallel_map
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.radial.nearest import GRID_DENSITIES, RAY_STEPS, read_rays

SIZE, FINE = 64, 128
POINTS = 768
KAPPAS = (0.0, 0.7, 1.5, 3.0, 5.0, 8.0, 14.0)
RADII = (0.02, 0.04, 0.07, 0.1, 0.14, 0.19)
# Lights are looked for this far outside the picture, and so far, in picture heights, about what is
# brightest: an object may hide most of the disc.
MARGIN = 0.3
ABOUT = np.linspace(-0.2, 0.2, 11)
VOTES = 1500
# Lights that a core searches among are a multiple of this.
SHARE = 32


def places(picture: Picture, seed: int) -> np.ndarray:
    """(lights, 2) candidates in texture coordinates."""
    inside = np.linspace(-MARGIN / 2, 1 + MARGIN / 2, 13)
    lattice = np.array(list(itertools.product(inside, inside)))
    h, w = picture.size
    about = np.array(list(itertools.product(ABOUT * h / w, ABOUT)))
    bright = np.unique(_bright(picture).round(2), axis=0)
    bright = (bright[:, None] + about[None]).reshape(-1, 2)
    return np.concatenate([_voted(picture, seed), bright, lattice])


def _voted(picture: Picture, seed: int, keep: int = 12) -> np.ndarray:
    """(keep, 2) maxima of the votes of gradient directions."""
    h, w = picture.size
    bright = ndimage.gaussian_filter(picture.levels.mean(-1), 1.0)
    down, across = np.gradient(bright)
    # Beside what is ignored or clipped an edge is an object's, or the scale's.
    calm = ndimage.binary_erosion(picture.valid & ~picture.clipped, iterations=3)
    slope = np.where(calm, np.hypot(down, across), 0.0)
    if np.count_nonzero(slope > 0.3) < 50:
        return np.zeros((0, 2))
    # Equal say for weak and strong edges, once they are above the rounding.
    chance = np.sqrt(np.where(slope > 0.3, slope, 0).ravel())
    rng = np.random.default_rng(seed)
    at = rng.choice(h * w, VOTES, p=chance / chance.sum())
    x, y = (at % w + 0.5) / h, 1 - (at // w + 0.5) / h
    nx, ny = across.ravel()[at] / slope.ravel()[at], -down.ravel()[at] / slope.ravel()[at]
    aspect = w / h
    u, v = (np.linspace(-MARGIN * s, (1 + MARGIN) * s, int(80 * max(s, 1))) for s in (aspect, 1.0))
    found = []
    both = parallel_map(lambda along: votes_for(u, v, x, y, nx, ny, along), (True, False))
    for votes in both:
        votes = ndimage.gaussian_filter(votes, 1.0)
        peaks = np.argwhere(votes == ndimage.maximum_filter(votes, 9))
        order = np.argsort(-votes[tuple(peaks.T)])[: keep // 2]
        found += [(u[j] / aspect, v[i]) for i, j in peaks[order]]
    return np.array(found)


def _bright(picture: Picture, keep: int = 6) -> np.ndarray:
    """(at most keep, 2) middles of the brightest compact regions."""
    h, w = picture.size
    bright = ndimage.gaussian_filter(picture.levels.min(-1), max(h, w) / 100)
    known = np.asarray(ndimage.binary_fill_holes(picture.valid | picture.clipped))
    bright = np.where(known, np.asarray(bright), 0)
    found = []
    for share in (0.999, 0.99, 0.96):
        label, count = regions(bright >= min(np.quantile(bright[known], share), 250))
        for i in 1 + np.argsort(-np.bincount(label.ravel())[1:])[:2] if count else ():
            row, column = np.argwhere(label == i).mean(0)
            found.append(((column + 0.5) / w, 1 - (row + 0.5) / h))
    return np.array(found[:keep]).reshape(-1, 2)


@cached_jit
def _search(rays, away, radii, along, basis, goal):
    """Cost and the coefficients of veil and disc, for every light, radius and shape.

    rays (lights, steps, points), away (lights, points) in picture heights, radii (r,), along
    (shapes, steps); basis (points, k) orthonormal, goal (points,) without what basis explains.
    Weights are in basis and goal.
    """
    t = (jnp.arange(RAY_STEPS) + 0.5) / RAY_STEPS
    weight, basis = basis[:, 0], basis[:, 1:]

    def without(values):
        values = values * weight[None]
        return values - (values @ basis) @ basis.T

    def one(light):
        ray, r = light
        v = without(along @ ray)

        def of_radius(radius):
            d = without(along @ (ray * ((1 - t)[:, None] * r[None] < radius)))
            tt, tv, td = goal @ goal, v @ goal, d @ goal
            vv, dd, vd = (v * v).sum(1), (d * d).sum(1), (v * d).sum(1)
            tiny = 1e-9
            determinant = vv * dd - vd * vd
            regular = determinant > 1e-4 * vv * dd + tiny
            a = jnp.where(regular, (tv * dd - td * vd) / jnp.where(regular, determinant, 1.0), 0.0)
            a = jnp.maximum(a, 0.0)
            b = jnp.maximum((td - a * vd) / (dd + tiny), 0.0)
            a = jnp.where(b > 0, a, jnp.maximum(tv / (vv + tiny), 0.0))
            cost = tt - 2 * (a * tv + b * td) + a * a * vv + 2 * a * b * vd + b * b * dd
            return cost, a, b

        return lax.map(of_radius, radii)

    return lax.map(one, (rays, away))


def starts(
    picture: Picture,
    open_: np.ndarray,
    terms: int,
    lights: np.ndarray,
    seed: int,
    keep: int,
    radii: Sequence[float] = RADII,
) -> list[dict[str, float]]:
    """The ``keep`` best, apart from each other, best first: light_x, light_y, radius, kappa,
    density, and what the disc and the veil add, ``gain`` and ``veil_gain``."""
    mean = picture.levels.mean(-1) / np.float32(LEVELS)
    usable = picture.valid & ~picture.clipped
    share = shrink(usable.astype(np.float32), (SIZE, SIZE))
    goal = shrink(np.where(usable, mean, 0), (SIZE, SIZE)) / np.maximum(share, 1e-3)
    h, w = goal.shape
    chosen = np.random.default_rng(seed).permutation(np.flatnonzero(share > 0.5))[:POINTS]
    if len(chosen) <= terms:
        raise InputError(
            "target: expected a picture that is not clipped nearly everywhere, got too few other "
            "pixels; give one with a lower exposure"
        )
    aspect = picture.size[1] / picture.size[0]
    u, v = (chosen % w + 0.5) / w, 1 - (chosen // w + 0.5) / h
    fine = shrink(open_, (FINE, FINE))
    at = np.stack([u * fine.shape[1] / 2 - 0.5, (1 - v) * fine.shape[0] / 2 - 0.5], -1)
    x, y = 2 * u - 1, 2 * v - 1
    basis = np.stack(term_values(x, y, terms), -1)
    shapes = np.array(list(itertools.product(KAPPAS, GRID_DENSITIES)), np.float32)
    middles = (np.arange(RAY_STEPS) + 0.5) / RAY_STEPS
    part = np.clip(shapes[:, 1:] * RAY_STEPS - np.arange(RAY_STEPS), 0, 1)
    along = (np.exp(-shapes[:, :1] * middles) * part / RAY_STEPS).astype(np.float32)
    away = np.hypot((u[None] - lights[:, :1]) * aspect, v[None] - lights[:, 1:])
    weight = np.ones(len(chosen))
    values = goal.ravel()[chosen]
    each = np.arange(len(lights))

    def read(some: np.ndarray) -> tuple[Array]:
        return (read_rays(*(on_device(z, np.float32) for z in (fine, lights[some], at))),)

    (rays,) = map_halves(read, each, SHARE)
    for _ in range(2):
        # Once more without what the best explains worst: objects that nothing gave away.
        q = np.linalg.qr(basis * weight[:, None])[0]
        left = weight * values - q @ (q.T @ (weight * values))
        others = radii, along, np.column_stack([weight, q]), left

        def search(some: np.ndarray, others=others) -> tuple[Array, ...]:
            numbers = rays[some], away[some], *others
            return _search(*(on_device(z, np.float32) for z in numbers))

        cost, a, b = map_halves(search, each, SHARE)
        if weight.min() == 0:
            break
        i, r, j = np.unravel_index(cost.argmin(), cost.shape)
        ray = rays[i]
        inside = (1 - middles)[:, None] * away[i][None] < radii[int(r)]
        model = a[i, r, j] * (along[j] @ ray) + b[i, r, j] * (along[j] @ (ray * inside))
        design = np.column_stack([basis, model])
        off = np.abs(values - design @ np.linalg.lstsq(design, values, rcond=None)[0])
        weight = (off <= np.quantile(off, 0.9)).astype(float)
    kept: list[tuple[int, int, int]] = []
    for flat in np.argsort(cost, axis=None)[:20_000]:
        i, r, j = np.unravel_index(flat, cost.shape)
        near = any(
            np.hypot(*(lights[i] - lights[p])) < 0.12 and abs(shapes[j, 1] - shapes[q, 1]) < 0.25
            for p, _, q in kept
        )
        if not near:
            kept.append((int(i), int(r), int(j)))
        if len(kept) == keep:
            break
    return [
        {
            "light_x": float(lights[i, 0]),
            "light_y": float(lights[i, 1]),
            "radius": float(radii[int(r)]),
            "kappa": float(shapes[j, 0]),
            "density": float(shapes[j, 1]),
            "gain": float(b[i, r, j]),
            "veil_gain": float(a[i, r, j]),
        }
        for i, r, j in kept
    ]
