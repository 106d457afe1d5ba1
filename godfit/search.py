"""From starting points to the neighbourhood of the best fit, on a few thousand pixels.

Coarse to fine: target and mask are blurred by the same amount, the blur is lowered in steps, and
starts that fall behind are dropped. ``settle`` finds coordinates and noise that suit each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from godfit.kept import kept
from godfit.likelihood import log_likelihood
from godfit.models import AbstractModel
from godfit.observation import Observation, Picture
from godfit.one_thread import one_thread
from godfit.side_by_side import ahead
from godfit.solver import Point, linearise, solve, solve_tangent

PIXELS = 2048
# What is blurred needs fewer.
BLURRED_PIXELS = 256
# Blur (as a share of the longer side), starts kept, sigma in levels.
LADDER = ((1 / 64, 3, 4.0), (1 / 128, 2, 2.0), (1 / 256, 1, 1.0), (1 / 512, 1, 1.0))
ALL = 6
# Where starts are good enough: none is blurred.
SHARP = ((0.0, 1, 1.0),)
# Noise below this many levels means that even the rounding of every pixel is explained.
EXPLAINED = 0.05
# Noise below this is lost in the rounding: masks that were rounded themselves leave as much.
WITHIN_ROUNDING = 0.125
# Levels, from well under the least that float32 leaves to the coarsest that means anything.
WALLS = 1 << 14
# Of so many values one says where the nearest to their walls are.
SAMPLED = 17
# Gain in log-likelihood for which pixels are not rendered again: kinks of the mask make it jump by
# as much between one float32 and the next.
SHORT = 4.0
# Where there are no bands there are no kinks that matter.
SHORT_WITHOUT = 0.05
# So few pixels are cheap to render again.
FEW = 1 << 13
# One pixel of so many says whether a tangent still holds.
SPOT_CHECKED = 128
# Of sigma, the most that they may be off it.
BENT = 0.1
# A step that moves no value by more than this share of sigma leads nowhere.
NOWHERE = 0.05
# Values whose derivatives are not held twice.
LARGE = 1 << 20
SIGMA_VALUES, FINAL_SIGMA_VALUES = 1 << 12, 1 << 15
RATIO = 3.0
SIGMAS = (0.005 * RATIO ** np.arange(10)).astype(np.float32)
MIDDLE = float(np.sqrt(SIGMAS[0] * SIGMAS[-1]))


def _total(prediction, lo, hi, sigma, foreign):
    return log_likelihood(prediction, lo, hi, sigma, foreign).sum()


@kept
def _likeliest(prediction, lo, hi, middle, first, last, part_of: int, foreign: float):
    """Sigma, the log-likelihood of all values there, and whether the first grid had it inside."""
    values = prediction, lo, hi
    few = values
    if prediction.shape[0] > part_of:
        # Drawn at random: a regular stride would fall into step with the rows.
        part = np.random.default_rng(0).integers(0, prediction.shape[0], part_of)
        few = prediction[part], lo[part], hi[part]

    def finer(k, state):
        middle, within = state
        step = math.log(RATIO) * 0.25 ** k.astype(middle.dtype)
        places = jnp.arange(len(SIGMAS)) - (len(SIGMAS) - 1) / 2
        sigmas = jnp.clip(middle * jnp.exp(step * places), SIGMAS[0], SIGMAS[-1])
        found = jax.lax.map(lambda sigma: _total(*few, sigma, foreign), sigmas)
        at = jnp.argmax(jnp.where(jnp.isnan(found), -jnp.inf, found))
        inside = (at > 0) & (at < len(SIGMAS) - 1)
        before, here, after = found[at - 1], found[at], found[at + 1]
        bend = before - 2 * here + after
        parabola = inside & (bend < 0) & jnp.isfinite(bend)
        shift = 0.5 * (before - after) / jnp.where(parabola, bend, 1.0)
        best = sigmas[at] * jnp.exp(jnp.where(parabola, step * shift, 0.0))
        best = jnp.clip(best, SIGMAS[0], SIGMAS[-1]).astype(middle.dtype)
        # Less than the least there is not to be had.
        return best, jnp.where(k == first, inside | (sigmas[at] <= SIGMAS[0]), within)

    sigma, within = jax.lax.fori_loop(first, last + 1, finer, (middle, jnp.bool_(True)))
    return jnp.stack([sigma, _total(*values, sigma, foreign), within.astype(sigma.dtype)])


def best_sigma(
    prediction: np.ndarray,
    seen: Observation,
    part_of: int = SIGMA_VALUES,
    near: float | None = None,
) -> tuple[float, float]:
    """Noise in levels that makes the pixels likeliest, and their log-likelihood.

    A grid of sigmas is refined by finer ones about its best and by a parabola in each, on
    ``part_of`` the values: n of them know sigma to a share of 1/sqrt(2 n). The values are the same
    at every call, and the parabola leaves no grid, so that likelihoods can be compared: of n values
    sigma off by a share d costs n d^2. The first grid has all sigmas, or those ``near`` one, unless
    the best lies at its end.
    """
    last = 2 if part_of == SIGMA_VALUES else 3
    first, middle = (0, MIDDLE) if near is None else (last - 1, near)
    found = _likeliest(
        prediction, seen.lo, seen.hi, np.float32(middle), np.int32(first), np.int32(last),
        part_of, seen.foreign,
    )  # fmt: skip
    sigma, likelihood, within = (float(z) for z in np.asarray(found))
    if near is not None and not within:
        return best_sigma(prediction, seen, part_of)
    return sigma, likelihood if math.isfinite(likelihood) else -math.inf


def veil(seen: Observation) -> Settled:
    """One value everywhere, the mean of the values, as the only coordinate, and the noise about
    it."""
    lo, hi = np.asarray(seen.lo), np.asarray(seen.hi)
    known = np.isfinite(lo) & np.isfinite(hi)
    level = np.float32(((lo + hi) / 2)[known].mean() if known.any() else 0.0)
    sigma, likelihood = best_sigma(np.full(len(lo), level), seen, FINAL_SIGMA_VALUES)
    return Settled(np.array([level], np.float32), sigma, likelihood, True)


_total_at = kept(_total)


def log_likelihood_at(prediction: np.ndarray, seen: Observation, sigma: float) -> float:
    """Log-likelihood of all pixels."""
    return float(_total_at(prediction, seen.lo, seen.hi, np.float32(sigma), seen.foreign))


def climb(
    picture: Picture,
    model: AbstractModel,
    starts: list[np.ndarray],
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
    report: Callable[[str], None],
    ladder: Sequence[tuple[float, int, float]] = LADDER,
    views: Iterable[Observation] = (),
) -> Point:
    """The best of ``starts`` after the ladder of blurs; ``views`` are the picture's, if known."""
    views = iter(views or blurred_views(picture, seed, ladder))
    points = [Point(start, np.inf, False, 0) for start in starts]
    for share, keep, sigma in ladder:
        seen = next(views)
        report(f"{len(points)} starts, blur of {share * max(picture.size):.1f} pixels")
        points = [
            solve(p.coordinates, free, held, model, seen, sigma, bounded=False) for p in points
        ]
        points.sort(key=lambda p: p.cost)
        # Without bands all starts are cheap to follow, and the right one may fall behind at first.
        points = _distinct(points)[: keep if model.banded else ALL]
    (sharp,) = views
    points = [solve(p.coordinates, free, held, model, sharp, 0.3) for p in points]
    return min(points, key=lambda p: p.cost)


def blurred_views(
    picture: Picture, seed: int, ladder: Sequence[tuple[float, int, float]] = LADDER
) -> Iterator[Observation]:
    """A few pixels of the picture for every blur of the ladder, and the same ones sharp; while one
    is used, those to come are made."""
    pixels = picture.informative(BLURRED_PIXELS, seed)
    blurs = [share * max(picture.size) for share, _, _ in ladder]
    return ahead(lambda blur: picture.observe(pixels, blur), [*blurs, 0.0])


def _distinct(points: list[Point]) -> list[Point]:
    """Points, cheapest first, that have not run into a cheaper one; where the picture leaves a
    coordinate open, such points agree in cost and in the places they put the light and density."""
    kept: list[Point] = []
    for p in points:
        if not any(
            abs(p.cost - q.cost) < 0.01 * q.cost
            and np.allclose(p.coordinates[2:], q.coordinates[2:], rtol=0.05, atol=0.03)
            for q in kept
        ):
            kept.append(p)
    return kept


class Settled(NamedTuple):
    """Coordinates and noise (levels) that suit each other; ``quiet`` when neither moved."""

    coordinates: np.ndarray
    sigma: float
    log_likelihood: float
    quiet: bool


class Tangent(NamedTuple):
    """The model about a point: levels (m,), derivatives (p, m) by coordinates over ``scale``."""

    prediction: np.ndarray
    jacobian: np.ndarray
    scale: np.ndarray

    def only(self, rows: np.ndarray) -> Tangent:
        """Of some of the levels."""
        return Tangent(self.prediction[rows], self.jacobian[:, rows], self.scale)

    def moved(self, by: np.ndarray) -> np.ndarray:
        """Levels where the coordinates are others ``by`` so much."""
        step = np.asarray(by / self.scale, np.float32)
        return np.asarray(_along(self.prediction, self.jacobian, step))


def tangent_at(z: np.ndarray, held: np.ndarray, model: AbstractModel, seen: Observation) -> Tangent:
    """The tangent at a point: every pixel is rendered, with its derivatives."""
    scale = model.scales(z)
    prediction, jacobian = linearise(z, held, scale, model, seen)
    return Tangent(np.asarray(prediction), np.asarray(jacobian), scale)


@kept
def _along(prediction, jacobian, step):
    # By XLA: BLAS in numpy keeps a core busy, waiting, long after the product is done.
    return prediction + step @ jacobian


def settle(
    start: np.ndarray,
    model: AbstractModel,
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
    *,
    rounds: int = 10,
    known: list[Tangent] | None = None,
    spot_check: bool = False,
) -> tuple[Settled, Tangent]:
    """Coordinates and noise that suit each other, until the log-likelihood stands still.

    The pixels are rendered once for each round. In between, the likelihood, which is far from
    quadratic when sigma is small, is solved on the tangent, with sigma and coordinates in turn.
    ``known`` holds the tangent at ``start``, if there is one already; it is taken out, so that
    nobody keeps it for longer than it is of use. With ``spot_check`` the pixels are not rendered
    again where a few of them say that the tangent is as good.
    """
    start = np.clip(start, *(np.asarray(bound, np.float32) for bound in model.bounds()))
    few = _drawn(seen) if spot_check else []
    settled, tangent = _in_rounds(start, model, seen, free, held, rounds, known or [], few)
    if settled.sigma > EXPLAINED:
        # On the way a few percent were enough; errors are quoted in units of it.
        sigma, likelihood = best_sigma(tangent.prediction, seen, FINAL_SIGMA_VALUES, settled.sigma)
        settled = settled._replace(sigma=sigma, log_likelihood=likelihood)
    return settled, tangent


def _in_rounds(start, model, seen, free, held, rounds, known, few) -> tuple[Settled, Tangent]:
    def render(z, seen=seen):
        return tangent_at(z, held, model, seen)

    tangent = known.pop() if known else render(start)
    sigma, likelihood = best_sigma(tangent.prediction, seen)
    best = Settled(start, sigma, likelihood, False)
    part = 1.0
    kinked = (model.banded or seen.foreign) and len(seen.pixels) > FEW
    short = SHORT if kinked else SHORT_WITHOUT
    for _ in range(rounds):
        goal, there = aim(best, tangent, model, seen, free)
        if goal.log_likelihood < best.log_likelihood + short:
            # So short a step that the tangent is as good as another rendering.
            return goal, there
        exact = _exact(goal, there, few, render, free, model) if few else None
        if exact is not None:
            return exact, there
        z = best.coordinates + np.float32(part) * (goal.coordinates - best.coordinates)
        del there
        if len(tangent.prediction) > LARGE:
            # Two sets of derivatives would be the most that a fit ever holds: rather made again.
            tangent = None
        there = render(z)
        sigma, likelihood = best_sigma(there.prediction, seen, near=goal.sigma)
        gained = likelihood - best.log_likelihood
        done = abs(gained) < short / 8
        if gained > 0:
            best, tangent = Settled(z, sigma, likelihood, False), there
            part = 1.0
        else:
            # On a kink, where neither the whole step nor a part of it gains, there is no further.
            done |= part < 1
            # Over a kink of the bilinear mask the tangent promises too much.
            part = 0.25
        del there
        tangent = tangent or render(best.coordinates)
        if done:
            return best._replace(quiet=True), tangent
    return best, tangent


def _drawn(seen: Observation) -> list[tuple[np.ndarray, Observation]]:
    """Some pixels, drawn at random, as observations of PIXELS each, with the values that are
    theirs; none of a picture that has few."""
    total = len(seen.pixels)
    count = total // (SPOT_CHECKED * PIXELS)
    drawn = np.random.default_rng(0).choice(total, (count, PIXELS), replace=False, shuffle=False)
    channels = np.arange(seen.channels)
    return [
        ((rows[:, None] * seen.channels + channels).reshape(-1), seen.only(rows))
        for rows in np.sort(drawn)
    ]


def _exact(
    goal: Settled,
    tangent: Tangent,
    few: list[tuple[np.ndarray, Observation]],
    render: Callable[[np.ndarray, Observation], Tangent],
    free: np.ndarray,
    model: AbstractModel,
) -> Settled | None:
    """The point whose rendering has the levels of the ``tangent``, which is bent away from them at
    the ``goal``: by least squares on a ``few`` pixels. None if there is no such point nearby."""
    z, values = goal.coordinates, np.concatenate([v for v, _ in few])
    of = tangent.only(values)

    def off(z):
        return np.concatenate([render(z, seen).prediction for _, seen in few]) - of.prediction

    lower, upper = (np.asarray(bound, np.float32) for bound in model.bounds())
    # What is on its bound stays there.
    moving = free & (z > lower) & (z < upper)
    bent, slopes = off(z), of.jacobian[moving].T
    if not (np.isfinite(bent).all() and np.isfinite(slopes).all()):
        return None
    with one_thread():
        step, *_ = np.linalg.lstsq(slopes, bent, rcond=None)
    z = z.copy()
    z[moving] -= step * tangent.scale[moving]
    z = np.clip(z, lower, upper)
    left = float(np.sqrt(np.square(off(z)).mean()))
    return goal._replace(coordinates=z) if left < BENT * min(goal.sigma, EXPLAINED) else None


def aim(
    at: Settled, tangent: Tangent, model: AbstractModel, seen: Observation, free: np.ndarray
) -> tuple[Settled, Tangent]:
    """Where the tangent's likelihood is largest, with the tangent taken there."""
    z, sigma, likelihood = at.coordinates, at.sigma, at.log_likelihood
    lo, hi = np.asarray(seen.lo), np.asarray(seen.hi)
    levels, slack = tangent.prediction, _slack(tangent.prediction, lo, hi)
    objected = None
    for _ in range(5):
        rows, of, walls = None, tangent, (seen.lo, seen.hi)
        if sigma < EXPLAINED:
            rows = _least(slack)
        if rows is not None:
            if objected is not None and np.array_equal(rows, objected):
                # Of many that are alike it is always the same ones that have a say.
                break
            of, walls = tangent.only(rows), (lo[rows], hi[rows])
        moved = of.moved(z - at.coordinates)
        there = solve_tangent(
            z, free, model, tangent.scale, moved, of.jacobian, *walls, sigma, seen.foreign
        ).coordinates
        moved = tangent.moved(there - at.coordinates)
        suits, found = best_sigma(moved, seen, near=sigma)
        if rows is not None and found < likelihood:
            if np.abs(moved - levels).max() < NOWHERE * sigma:
                break
            # Values that were left out object: from now on they have a say.
            slack, objected = np.minimum(slack, _slack(moved, lo, hi)), rows
            continue
        z, levels, before, sigma, likelihood = there, moved, sigma, suits, found
        if abs(sigma - before) < 0.05 * before:
            break
    if likelihood <= at.log_likelihood:
        return at._replace(quiet=True), tangent
    return Settled(z, sigma, likelihood, True), tangent._replace(prediction=levels)


def _slack(prediction: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """(m,) levels from the nearer end of each interval, less than 0 outside."""
    return np.minimum(prediction - lo, hi - prediction)


def _least(slack: np.ndarray) -> np.ndarray | None:
    """The values nearest to the ends of their intervals, None if that is all. Where rounding is all
    the noise there is, the others are far inside and have no say."""
    count = max(WALLS, len(slack) // 16)
    if len(slack) <= count:
        return None
    # A sample says which may be among them: to sort all of them out takes ten times as long.
    few = slack[::SAMPLED]
    most = min(len(few) - 1, int(1.2 * count / SAMPLED) + 16)
    near = np.flatnonzero(slack <= np.partition(few, most)[most])
    if len(near) < count:
        near = np.arange(len(slack))
    return np.sort(near[np.argpartition(slack[near], count - 1)[:count]])
