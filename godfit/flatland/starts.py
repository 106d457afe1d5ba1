"""Starting points for the light in the plane: suns all around, of several widths, are tried on a
few hundred pixels, with the exposure and the colours, which are linear, solved for."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from godfit.flatland.model import PARAMETERS, Flatland
from godfit.flatland.sky import Sky
from godfit.inference.observation import Picture
from godfit.inference.problem import Problem
from godfit.inference.strategy import Open, Stage, left_open, stages, starts, trading
from godfit.io.image import LEVELS, decode

PIXELS = 600
ANGLES = np.arange(0.0, 360.0, 7.5)
WIDTHS = (6.0, 12.0, 25.0, 50.0, 90.0, 140.0)
# Starts are at least this much apart, in degrees.
APART = 15.0


@eqx.filter_jit
def _lobes(angles, widths, rays: int):
    """(suns, rays) what a sun of radiance one adds to every ray's part of the circle."""

    def one(angle, width):
        return Sky(angle, width, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)).over(rays)[:, 0]

    return eqx.filter_vmap(one)(angles, widths)


@starts.register
def plane_starts(
    model: Flatland, picture: Picture, given: dict[str, float], *, keep: int, seed: int
) -> list[np.ndarray]:
    """The ``keep`` best starting points in the model's coordinates, best first."""
    pixels = picture.informative(PIXELS, seed)
    pixels = pixels[~picture.clipped.reshape(-1)[pixels]]
    parts = picture.mask.reshape(-1, picture.mask.shape[-1])[pixels].astype(np.float64)
    levels = picture.levels.reshape(-1, picture.channels)[pixels] / np.float32(LEVELS)
    target = np.asarray(decode(levels, picture.transfer), np.float64)
    angles, widths = (
        np.array([given[name]]) if name in given else np.asarray(grid)
        for name, grid in (("sun_angle", ANGLES), ("sun_width", WIDTHS))
    )
    suns = np.stack(np.meshgrid(angles, widths, indexing="ij"), -1).reshape(-1, 2)
    lobes = np.asarray(_lobes(jnp.asarray(suns[:, 0]), jnp.asarray(suns[:, 1]), model.samples))
    lit, open_ = parts[:, 3:] @ lobes.T.astype(np.float64), parts[:, 3:].sum(1)
    found = []
    for sun, by_sun in zip(suns, lit.T, strict=True):
        z, cost = _solved(parts[:, :3], by_sun, open_, target, given)
        found.append((cost, np.concatenate([z[:1], sun, z[1:]])))
    found.sort(key=lambda each: each[0])
    kept: list[np.ndarray] = []
    for _, z in found:
        near = [abs((z[1] - other[1] + 180) % 360 - 180) < APART for other in kept]
        if not any(near):
            kept.append(z)
        if len(kept) == keep:
            break
    held = np.array([given.get(p.name, np.nan) for p in PARAMETERS], np.float32)
    return [
        np.asarray(
            model.moved(jnp.asarray(z, jnp.float32), jnp.asarray(held)).coordinates(), np.float32
        )
        for z in kept
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


def _solved(own, by_sun, open_, target, given) -> tuple[np.ndarray, float]:
    """(7,) exposure and exposure times sun and sky, none below zero, and the cost."""
    rows, values = [], []
    for c in range(3):
        row = np.zeros((len(open_), 7))
        row[:, 0], row[:, 1 + c], row[:, 4 + c] = own[:, c], by_sun, open_
        rows.append(row)
        values.append(target[:, c])
    matrix, value = np.concatenate(rows), np.concatenate(values)
    fixed = "exposure" in given
    if fixed:
        value = value - matrix[:, 0] * given["exposure"]
        matrix = matrix[:, 1:]
    # A little towards zero, so that what nothing shows stays there.
    square = matrix.T @ matrix
    square += 1e-9 * np.trace(square) * np.eye(len(square)) + 1e-12 * np.eye(len(square))
    z = np.maximum(np.linalg.solve(square, matrix.T @ value), 0)
    cost = float(np.square(value - matrix @ z).sum())
    return (np.concatenate([[given["exposure"]], z]) if fixed else z), cost
