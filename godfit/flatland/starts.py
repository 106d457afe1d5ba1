"""Starting points for the light in the plane: suns all around, of several widths, are tried on a
few hundred pixels. Exposure and colours are linear and solved for.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from godfit.flatland.model import PLANE_PARAMETERS, Flatland
from godfit.flatland.sky import Sky
from godfit.inference.observation import Picture
from godfit.inference.problem import Problem
from godfit.inference.strategy import Open, Stage, left_open, stages, starts, trading
from godfit.io.image import LEVELS, decode

SCREENED_PIXELS = 600
"""Pixels that starting points are compared on: many times the seven unknowns of a linear solve."""

SCREENED_SUN_ANGLES = np.arange(0.0, 360.0, 7.5)
"""Degrees: nearer to each other than the narrowest screened sun is wide, so none is missed."""

SCREENED_SUN_WIDTHS = (6.0, 12.0, 25.0, 50.0, 90.0, 140.0)
"""Degrees to either side, each about twice the last: a fit finds its way between two of them."""

SUN_SEPARATION = 15.0
"""Degrees: suns of two starting points differ by at least this, two steps of the angles' grid, so
that they are different minima."""

RELATIVE_RIDGE = 1e-9
"""Share of the normal matrix's trace that is added to its diagonal: far below what bytes determine;
a colour that no pixel depends on becomes 0."""

ABSOLUTE_RIDGE = 1e-12
"""Added to the diagonal as well: the matrix is regular even where no pixel has any light."""


@eqx.filter_jit
def _lobes(angles, widths, rays: int):
    """(suns, rays) mean radiance over every ray's part of the circle, of suns of radiance 1."""

    def one(angle, width):
        return Sky(angle, width, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)).over(rays)[:, 0]

    return eqx.filter_vmap(one)(angles, widths)


@starts.register
def plane_starts(
    model: Flatland, picture: Picture, given: dict[str, float], *, keep: int, seed: int
) -> list[np.ndarray]:
    """The ``keep`` best starting points in the model's coordinates, best first.

    ``given`` are parameters whose values are known; ``seed`` chooses the pixels.
    """
    pixels = picture.informative(SCREENED_PIXELS, seed)
    pixels = pixels[~picture.clipped.reshape(-1)[pixels]]
    parts = picture.mask.reshape(-1, picture.mask.shape[-1])[pixels].astype(np.float64)
    levels = picture.levels.reshape(-1, picture.channels)[pixels] / np.float32(LEVELS)
    target = np.asarray(decode(levels, picture.transfer), np.float64)
    angles, widths = (
        np.array([given[name]]) if name in given else np.asarray(grid)
        for name, grid in (
            ("sun_angle", SCREENED_SUN_ANGLES),
            ("sun_width", SCREENED_SUN_WIDTHS),
        )
    )
    suns = np.stack(np.meshgrid(angles, widths, indexing="ij"), -1).reshape(-1, 2)
    lobes = np.asarray(_lobes(jnp.asarray(suns[:, 0]), jnp.asarray(suns[:, 1]), model.samples))
    by_sun, by_sky = parts[:, 3:] @ lobes.T.astype(np.float64), parts[:, 3:].sum(1)
    candidates = []
    for sun, by_this_sun in zip(suns, by_sun.T, strict=True):
        z, cost = _linear_solution((parts[:, :3], by_this_sun, by_sky), target, given)
        candidates.append((cost, np.concatenate([z[:1], sun, z[1:]])))
    candidates.sort(key=lambda candidate: candidate[0])
    separate: list[np.ndarray] = []
    for _, z in candidates:
        away = [abs((z[1] - other[1] + 180) % 360 - 180) for other in separate]
        if not any(degrees < SUN_SEPARATION for degrees in away):
            separate.append(z)
        if len(separate) == keep:
            break
    held = np.array([given.get(p.name, np.nan) for p in PLANE_PARAMETERS], np.float32)
    return [
        np.asarray(
            model.moved(jnp.asarray(z, jnp.float32), jnp.asarray(held)).coordinates(), np.float32
        )
        for z in separate
    ]


@stages.register
def _(model: Flatland) -> tuple[Stage, ...]:
    """Starts are good enough: nothing is blurred."""
    return (Stage(0.0, 1, 1.0),)


@trading.register
def _(model: Flatland) -> tuple[str, ...]:
    return "exposure", "sun_angle"


@left_open.register
def _(model: Flatland, problem: Problem) -> Open | None:
    """The exposure is known by the canvas's own light alone."""
    if not problem.is_free("exposure") or emits(problem.picture):
        return None
    return Open("exposure", note="the canvas sends out no light: exposure held at {:g}")


def emits(picture: Picture) -> bool:
    """Whether the canvas itself sends out light."""
    return bool((picture.mask[..., :3] > 0).any())


def _linear_solution(
    responses: tuple[np.ndarray, np.ndarray, np.ndarray],
    target: np.ndarray,
    given: dict[str, float],
) -> tuple[np.ndarray, float]:
    """(7,) exposure and exposure times sun and sky, none below zero, and the sum of squares.

    ``responses`` are the pixels' derivatives by exposure (n, 3), by the sun's radiance (n,) and by
    the sky's (n,); ``target`` (n, 3) is linear.
    """
    own, by_sun, by_sky = responses
    rows, values = [], []
    for c in range(3):
        row = np.zeros((len(by_sky), 7))
        row[:, 0], row[:, 1 + c], row[:, 4 + c] = own[:, c], by_sun, by_sky
        rows.append(row)
        values.append(target[:, c])
    matrix, value = np.concatenate(rows), np.concatenate(values)
    fixed = "exposure" in given
    if fixed:
        value = value - matrix[:, 0] * given["exposure"]
        matrix = matrix[:, 1:]
    normal = matrix.T @ matrix
    unit = np.eye(len(normal))
    normal += RELATIVE_RIDGE * np.trace(normal) * unit + ABSOLUTE_RIDGE * unit
    z = np.maximum(np.linalg.solve(normal, matrix.T @ value), 0)
    cost = float(np.square(value - matrix @ z).sum())
    return (np.concatenate([[given["exposure"]], z]) if fixed else z), cost
