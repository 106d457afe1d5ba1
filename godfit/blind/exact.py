"""From the answer of a search on a copy to exact taps and the likelihood of the picture's pixels.

All hypotheses are one model here, a disc on a veil behind an open mask (``models/disc_light.py``):
under *bright* the open mask is the bright pass and there is no veil.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from godfit.blind.hypotheses import (
    LEAST_SHARE,
    bright_pass,
    dark_threshold,
    ground_colour,
    grown,
)
from godfit.blind.pairs import drawn, solved
from godfit.blind.reduced import SCREENED_UNIT, Reduced, additive, clipped_pixels
from godfit.blind.search import FINE_PAIRS, Candidate, in_pixels
from godfit.inference.noise import best_sigma
from godfit.inference.observation import Observation, Picture
from godfit.inference.problem import Problem, given_and_held
from godfit.inference.settle import Settled, settle
from godfit.inference.solver import Tangent, solve, tangent_at
from godfit.io.image import LEVELS
from godfit.io.sources import shrink_mask
from godfit.models.background import TERM_COUNTS
from godfit.models.coordinates import (
    DENSITY,
    EDGE,
    EXPOSURE,
    FIRST_BACKGROUND,
    GAIN,
    KAPPA,
    LIGHT_X,
    LIGHT_Y,
    RADIUS,
    VEIL,
)
from godfit.models.disc_light import MAX_RADIUS, DiscLight
from godfit.models.mitchell import Mitchell

EXPOSURE_GUESS = 0.1
"""Exposure that is held where a shader has no default: its product with the weight counts."""
FIRST_EDGE = 0.003
"""Width of the disc's edge to begin with, in picture heights: a pixel or two."""
PIXELS = 16_384
"""Pixels of the likelihood, in blocks: more hardly change the errors of a picture's own noise."""
BLOCK = (8, 32)
"""Rows and columns of a block: what errs together shows in neighbours, and sums along rows cost
less."""
SIGMAS = (8.0, 3.0, 1.0)
"""Noise in levels allowed for, lowered solve by solve."""
RADII = (1.0, 0.8)
"""Shares of the search's radius that the disc starts with: a clipped disc is smaller than what is
bright, and radius and gain trade."""
CALM = 3.0
"""Texture in levels up to which the likelihood of single pixels knows more than differences."""
MOST_SECTORS = 24
"""Sectors about the light whose pixels err together, at least: an object lies in a few of them."""
ROUNDS = 25
"""Rounds of the likelihood, at most: the valley in which attenuation and gain trade is long."""
DISC_MARGIN = 1.25
"""How much larger than its circle a disc is taken, where no ray may meet it: a sphere at 30 degrees
from the axis of a camera is an ellipse that is 1.15 times as long and off its centre."""
FEWEST_BEYOND = 2_000
"""Pixels whose rays end before the disc, without which nothing is solved for there."""


class Given(NamedTuple):
    """What the user gives: values that are held (None: at the start or the default) and ones that
    are started from, and the light pass's size against the picture's, ``pass_scale``."""

    fix: Mapping[str, float | None]
    start: Mapping[str, float]
    pass_scale: float | None


class Posed(NamedTuple):
    """A picture and its ``copy``, the ``shading`` at no particular point, and what is ``given``;
    whether the shading is the picture's own, or stands in for another: then the light alone is of
    use."""

    copy: Reduced
    picture: Picture
    shading: Mitchell
    given: Given
    own: bool = True


class Exact(NamedTuple):
    """What is solved: the ``problem`` at the pixels of ``seen``, where it ended, ``settled`` with
    its ``tangent``, and whether single pixels were solved for, ``exact``."""

    problem: Problem
    seen: Observation
    settled: Settled
    tangent: Tangent
    exact: bool


def open_mask(candidate: Candidate, posed: Posed) -> tuple[np.ndarray, np.ndarray]:
    """(h, w) the open mask of a hypothesis at the picture's size, and (h, w) the pixels that are
    data: of an object nobody knows its own colour, and of the bright mask its own light."""
    copy, picture, shading = posed[:3]
    values = additive(picture.levels / np.float32(LEVELS), shading.convention)
    values = np.broadcast_to(values, (*values.shape[:2], 3))
    clipped = clipped_pixels(picture.levels)
    name = candidate.hypothesis.name
    if name == "bright":
        open_ = bright_pass(values[..., 0], picture.valid)
        return open_.astype(np.float32), picture.valid & ~clipped & ~grown(open_ > 0)
    if name == "colour":
        open_ = ground_colour(values, picture.valid, clipped)
    elif name == "sky":
        open_ = (values.mean(-1) > dark_threshold(copy.values.mean(-1)[copy.valid])) | clipped
        return open_.astype(np.float32), picture.valid & ~clipped & ~grown(open_)
    else:
        threshold = dark_threshold(copy.values.mean(-1)[copy.usable])
        open_ = (values.mean(-1) > threshold) | clipped
    # Under panels nothing is known, and most of the ground is open.
    open_ = open_ | ~picture.valid
    return open_.astype(np.float32), picture.valid & open_ & ~grown(~open_)


def solved_exactly(
    candidate: Candidate, posed: Posed, seed: int, stopped: Callable[[], bool]
) -> Exact:
    """The exact answer, from that of the search. Next to texture only what is linear is solved."""
    picture, shading = posed.picture, posed.shading
    open_, known = open_mask(candidate, posed)
    if known.mean() < LEAST_SHARE:
        known = picture.valid
    unit = SCREENED_UNIT if shading.convention.blend == "screen" else 1.0
    texture = drawn(candidate.hypothesis, FINE_PAIRS, seed).spread * LEVELS * unit
    sky = candidate.hypothesis.name == "sky"
    veiled = candidate.hypothesis.name in ("colour", "darkness")
    calm = posed.own and veiled and texture < CALM
    mask = shrink_mask(open_, posed.given.pass_scale or 1.0)
    picture = dataclasses.replace(picture, mask=mask, valid=known)
    degree = 0 if calm else 2
    model = DiscLight(
        shading,
        np.array([0.1, FIRST_EDGE, 0.05]),
        np.zeros((TERM_COUNTS[degree], picture.channels)),
    )
    start, held = _start(candidate, model, posed, picture if sky else posed.picture, seed)
    free = np.isnan(held) & model.used
    linear = free & model.linear()
    linear[[GAIN, VEIL]] = free[[GAIN, VEIL]]
    seen = picture.observe(blocks(picture, seed))
    problem = Problem(model, picture, free, held, seed)
    first = problem.replaced(free=linear)
    if calm and not stopped():
        ends = []
        for share in RADII:
            z = start.copy()
            if free[RADIUS]:
                z[RADIUS] *= share
            z = solve(z, first, seen, SIGMAS[0]).coordinates
            for sigma in SIGMAS:
                point = solve(z, problem, seen, sigma)
                z = point.coordinates
            ends.append(point)
        best = min(ends, key=lambda point: point.cost)
        settled, tangent = settle(best.coordinates, problem, seen, rounds=ROUNDS)
        return Exact(problem, seen, settled, tangent, True)
    point = solve(start, first, seen, max(SIGMAS[0], texture)).coordinates
    tangent = tangent_at(point, problem, seen)
    sigma, likelihood = best_sigma(tangent.prediction, seen)
    return Exact(problem, seen, Settled(point, sigma, likelihood, True), tangent, False)


def beyond_disc(found: Exact) -> Exact | None:
    """The answer of the pixels whose rays end before they meet the disc, None where there are few.

    These say nothing of the disc, whose numbers are held, and need no model of it: it is a circle
    to the model, and a real one may be a sphere, a square or a picture.
    """
    problem, z = found.problem, found.settled.coordinates
    picture, share = problem.picture, 1 - float(z[DENSITY])
    if not (found.exact and problem.free[VEIL] and share > 0):
        return None
    h, w = picture.size
    row, column = np.mgrid[:h, :w]
    x, y = column + 0.5 - z[LIGHT_X] * w, row + 0.5 - (1 - z[LIGHT_Y]) * h
    outside = np.hypot(x, y) * share > DISC_MARGIN * z[RADIUS] * h
    picture = dataclasses.replace(picture, valid=picture.valid & outside)
    if np.count_nonzero(picture.valid) < FEWEST_BEYOND:
        return None
    free, held = problem.free.copy(), problem.held.copy()
    disc = [GAIN, RADIUS, EDGE]
    free[disc], held[disc] = False, z[disc]
    problem = problem.replaced(picture=picture, free=free, held=held)
    seen = picture.observe(blocks(picture, problem.seed))
    settled, tangent = settle(z, problem, seen, rounds=ROUNDS)
    return Exact(problem, seen, settled, tangent, True)


def _start(
    candidate: Candidate, model: DiscLight, posed: Posed, picture: Picture, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """(p,) the coordinates that the search found, with the background of ``picture``, and (p,)
    those that are held, NaN where free."""
    given, held = given_and_held(model, posed.given.fix, posed.given.start)
    hypothesis = candidate.hypothesis
    h, w = hypothesis.values.shape
    pairs = drawn(hypothesis, FINE_PAIRS, seed)
    gains = solved(in_pixels(candidate.point, (h, w)), pairs, hypothesis)[1][0]
    scale = SCREENED_UNIT if model.convention.blend == "screen" else 1.0
    gains = scale * gains[: len(hypothesis.maps)] / candidate.density
    z = np.zeros(len(held), np.float32)
    z[KAPPA], z[DENSITY] = candidate.point[2], min(candidate.density, 1.0)
    z[LIGHT_X], z[LIGHT_Y] = candidate.place
    z[RADIUS], z[EDGE] = candidate.radius * max(h, w) / h, FIRST_EDGE
    z[GAIN], z[VEIL] = gains[-1], gains[0] if len(gains) > 1 else 0.0
    values = picture.levels[picture.valid] / np.float32(LEVELS)
    background = np.median(values, axis=0)
    z[FIRST_BACKGROUND : FIRST_BACKGROUND + model.background.shape[1]] = background
    if np.isnan(held[EXPOSURE]) and np.isnan(held[3]):
        # Only the disc itself would separate a pixel's own value from its rays, and it is clipped.
        default = model.shading.defaults.get("exposure", EXPOSURE_GUESS)
        held[EXPOSURE] = given.get("exposure", default)
    if hypothesis.name == "bright":
        held[VEIL] = 0.0
    if hypothesis.name == "sky":
        # A disc without end.
        z[GAIN], held[VEIL], held[RADIUS], held[EDGE] = gains.sum(), 0.0, MAX_RADIUS, z[EDGE]
    z = np.where(np.isnan(held), z, held).astype(np.float32)
    lower, upper = (np.asarray(end, np.float32) for end in model.bounds())
    return np.clip(z, lower, upper), held


def blocks(picture: Picture, seed: int) -> np.ndarray:
    """Sorted indices of PIXELS valid pixels, in blocks drawn at random; all where there are
    fewer."""
    h, w = picture.size
    tall, wide = BLOCK
    rows, columns = -(-h // tall), -(-w // wide)
    order = np.random.default_rng(seed).permutation(rows * columns)
    rank = np.kron(np.argsort(order).reshape(rows, columns), np.ones(BLOCK, int))[:h, :w].ravel()
    pixels = np.flatnonzero(picture.valid)
    # Always as many, the last block cut off: another number would be compiled anew.
    return np.sort(pixels[np.argsort(rank[pixels], kind="stable")[:PIXELS]])


def sector_covariance(found: Exact) -> np.ndarray:
    """(p, p) covariance of the coordinates from the slopes of sectors about the light.

    Pixels of one sector err together, by a misplaced edge or a background of its own. The slopes of
    the sectors' likelihoods stand for independent draws (White, Econometrica 50 (1982), 1).
    """
    problem, seen, tangent = found.problem, found.seen, found.tangent
    free, z = problem.free, found.settled.coordinates
    h, w = seen.size
    pixels = np.asarray(seen.pixels)
    x, y = (pixels % w + 0.5) / h - z[LIGHT_X] * w / h, z[LIGHT_Y] - 1 + (pixels // w + 0.5) / h
    rank = np.argsort(np.argsort(np.arctan2(y, x)))
    count = max(MOST_SECTORS, 2 * int(free.sum()))
    sector = np.repeat(rank * count // len(rank), seen.channels)
    lo, hi = np.asarray(seen.lo), np.asarray(seen.hi)
    known = np.isfinite(lo) & np.isfinite(hi)
    left = np.where(known, (lo + hi) / 2 - tangent.prediction, 0.0)
    sigma = max(found.settled.sigma, 0.3)
    # Weights of a likelihood with heavy tails: what is foreign says nothing.
    weight = known / (1 + (left / (3 * sigma)) ** 2)
    rows = tangent.jacobian[free].astype(np.float64)
    information = (rows * weight) @ rows.T
    slopes = np.stack([
        np.bincount(sector, row * weight * left, minlength=count) for row in rows
    ])  # fmt: skip
    size = np.sqrt(np.maximum(np.diag(information), 1e-30))
    inverse = np.linalg.pinv(information / np.outer(size, size), rcond=1e-10) / np.outer(size, size)
    inside = inverse @ slopes
    out = np.zeros((len(free), len(free)))
    scale = np.asarray(tangent.scale, np.float64)[free]
    covariance = inside @ inside.T * count / (count - int(free.sum()))
    out[np.ix_(free, free)] = covariance * np.outer(scale, scale)
    return out
