"""Starting points for Hoffman-Preetham: a coarse screening, as for Mitchell's sum.

Every combination of a grid of suns, turbidities, lobes and optical depths is evaluated on a few
hundred pixels. The sun's irradiance enters linearly and is solved for exactly. See
``screening.py``.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from godfit.inference.observation import Picture
from godfit.inference.strategy import starts, trading
from godfit.inference.variable_projection import nonnegative_one
from godfit.io.filters import doubled, grey, shrink
from godfit.io.image import LEVELS, decode
from godfit.models.atmosphere import zenith_angle
from godfit.models.hoffman_preetham import MIN_OPTICAL_DEPTH, HoffmanPreetham
from godfit.scattering.radial.nearest import read_rays
from godfit.search.screening import SCREENING_SIZE, distinct_starts, light_grid, light_places

DAYLIGHT_POINTS = 256
"""Pixels of the small copy that are compared, each in three channels: they limit the time."""
TURBIDITIES = (1.3, 2.5, 6.0)
"""Turbidities that are tried: very clear, clear and hazy air."""
LOBES = (0.0, 0.5, 0.75, 0.9)
"""Asymmetries g of the Henyey-Greenstein phase function that are tried."""
DEPTHS = (0.05, 0.4, 1.2, 3.0)
"""Optical depths of the scene that are tried, from almost none to opaque."""


class _Points(NamedTuple):
    """Values at the points of the small copy: along the view from each its distance and direction,
    the ordinary pass, the target, and the weight, 1 or 0, of the point."""

    distance: Float[Array, " points"]
    direction: Float[Array, "points 3"]
    surface: Float[Array, "points 3"]
    target: Float[Array, "points 3"]
    weight: Float[Array, " points"]


@eqx.filter_jit
def _solve(
    model: HoffmanPreetham,
    suns: Float[Array, "suns 2"],
    shapes: Float[Array, "shapes 3"],
    lit: Float[Array, "suns points"],
    points: _Points,
    aspect: float,
):
    """Gain, not negative, and cost for every sun and shape (depth, turbidity, g)."""
    up, trust = model.view.up, points.weight[:, None]

    def one(sun_lit):
        sun, lit = sun_lit
        ahead = model.view.direction(sun[0], sun[1], aspect)
        cos, zenith = points.direction @ ahead, zenith_angle(ahead, up)

        def shape(z):
            air = model.moved(jnp.concatenate([jnp.ones(1, z.dtype), z, sun])).air
            added = lit[:, None] * air.inscattered(points.distance, cos, zenith)
            unexplained = points.target - lit[:, None] * points.surface * air.transmitted(
                points.distance
            )
            along, size = (trust * added * unexplained).sum(), (trust * added**2).sum()
            gain = nonnegative_one(along, size)
            return gain, (trust * (unexplained - gain * added) ** 2).sum()

        return jax.vmap(shape)(shapes)

    return lax.map(one, (suns, lit))


@starts.register
def daylight_starts(
    model: HoffmanPreetham, picture: Picture, given: dict[str, float], *, keep: int, seed: int
) -> list[np.ndarray]:
    """The ``keep`` best starting points in the model's coordinates, best first. Parameters in
    ``given`` are held at their values."""
    light = np.asarray(decode(picture.levels / np.float32(LEVELS), picture.transfer))
    target = shrink(light, (SCREENING_SIZE, SCREENING_SIZE))
    trust = (
        shrink(
            (picture.valid & ~picture.clipped).astype(np.float32), (SCREENING_SIZE, SCREENING_SIZE)
        )
        > 0.99
    )
    mask = shrink(grey(picture.mask), (SCREENING_SIZE, SCREENING_SIZE))
    h, w = target.shape[:2]
    chosen = np.random.default_rng(seed).permutation(h * w)[:DAYLIGHT_POINTS]
    at = np.stack(
        [
            (chosen % w + 0.5) * mask.shape[1] / w - 0.5,
            (chosen // w + 0.5) * mask.shape[0] / h - 0.5,
        ],
        -1,
    ).astype(np.float32)
    surface = np.zeros((len(chosen), 3), np.float32)
    if picture.background is not None:
        surface = (
            surface
            + shrink(picture.background, (SCREENING_SIZE, SCREENING_SIZE)).reshape(h * w, -1)[
                chosen
            ]
        )
    suns, _ = light_places(light_grid(target.mean(-1), seed), given, 1)
    fine = doubled(mask)
    lit = read_rays(jnp.asarray(fine), jnp.asarray(suns), jnp.asarray(at)).mean(1)
    shapes = _shapes(model, given)
    distance, direction = model.view.rays((h, w), jnp.asarray(chosen))
    points = _Points(
        distance, direction, jnp.asarray(surface),
        jnp.asarray(target.reshape(h * w, -1)[chosen]),
        jnp.asarray(trust.ravel()[chosen].astype(np.float32)),
    )  # fmt: skip
    aspect = picture.size[1] / picture.size[0]
    gain, cost = _solve(model, jnp.asarray(suns), jnp.asarray(shapes), lit, points, aspect)
    gain, cost = np.asarray(gain), np.asarray(cost)
    held = np.array([given.get(name, np.nan) for name in model.parameters], np.float32)
    found = []
    for i, j in distinct_starts(cost, suns, shapes[:, 1:], keep):
        z = np.array([max(gain[i, j], 1e-4), *shapes[j], *suns[i]], np.float32)
        z = np.asarray(model.moved(jnp.asarray(z), jnp.asarray(held)).coordinates(), np.float32)
        found.append(z)
    return found


@trading.register
def _(model: HoffmanPreetham) -> tuple[str, ...]:
    return "e_sun", "scale"


def _shapes(model: HoffmanPreetham, given: dict[str, float]) -> np.ndarray:
    """(shapes, 3) depth, turbidity, g."""
    turbidities = (given["turbidity"],) if "turbidity" in given else TURBIDITIES
    lobes = (given["g"],) if "g" in given else LOBES
    shapes = []
    for turbidity, g in itertools.product(turbidities, lobes):
        depths = DEPTHS
        if "scale" in given:
            here = eqx.tree_at(
                lambda m: (m.air.turbidity, m.air.scale),
                model,
                (jnp.float32(turbidity), jnp.float32(given["scale"])),
            )
            depths = (max(float(here.coordinates()[1]), MIN_OPTICAL_DEPTH),)
        shapes += [(depth, turbidity, g) for depth in depths]
    return np.array(shapes, np.float32)
