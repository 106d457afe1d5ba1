"""Mask and numbers of two screenshots in turn, on the exact taps of the shader."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from godfit.blind.pair_mask import labelled_mask
from godfit.blind.two_screenshots import Pair
from godfit.errors import Remark
from godfit.inference.fitted import Found
from godfit.inference.information import evidence
from godfit.inference.noise import best_sigma
from godfit.inference.problem import SEARCH_PIXELS, Problem, pixels_used
from godfit.inference.settle import Settled, settle
from godfit.inference.solver import tangent_at

ROUNDS = 6
"""Turns of mask and numbers, at most: those that succeed need three or four."""
BETTER = 0.97
"""Noise of a turn against that of the turn before from which another one is taken."""
EXPLAINED_NOISE = 0.5
"""Noise in levels from which an estimated mask leaves something unexplained: rounding twice leaves
less."""
BESIDE_CLIPPED = 2
"""Texels beside clipped ones that are not fitted: their mask is a guess."""
EXPLAINED = (
    "the mask that was estimated explains the pair, but errors under such a mask are not known: "
    "check mask.png, correct it, and give it as --mask with --background for numbers with errors"
)
"""What holds of the numbers where the mask explains the pair."""
SCENE_MASK = (
    "the mask is a guess, open where the ordinary pass is not dark: the light is as good as that, "
    "and errors are not known; check mask.png, correct it, and give it as --mask with --background"
)
"""What holds of the numbers where the mask is that of the scene's darkness."""
SCENE_NOTE = Remark(
    "mask: no mask is solved for a shader whose sum is of several passes: it is open where "
    "the ordinary pass is not dark",
    "mask",
)
"""A note on that mask."""
NEXT = (
    "light and numbers are those of a search, without errors: correct mask.png and give it as "
    "--mask, take the pair at a lower exposure, or give --light-near U,V"
)
"""What to do where the mask does not explain the pair."""


class Turned(NamedTuple):
    """Where mask and numbers in turn led: the problem with that mask, and its solution."""

    problem: Problem
    settled: Settled


def alternate(
    pair: Pair,
    posed: Callable[[Pair, np.ndarray, np.ndarray], Problem],
    report: Callable[[str], None],
) -> Found:
    """The fit of two screenshots from where the search led. ``posed`` makes the problem of a pair,
    a mask (h, w, c) and (h, w), which of its texels are fitted."""
    turned = _in_turn(pair, posed, report)
    if turned is not None and turned.settled.sigma <= EXPLAINED_NOISE:
        return _refined(turned)
    return _unrefined(pair, posed)


def _in_turn(pair: Pair, posed, report: Callable[[str], None]) -> Turned | None:
    best, model, mask = None, pair.model, pair.mask
    for turn in range(ROUNDS if not pair.objection else 0):
        report(f"mask and numbers in turn, {turn + 1}")
        mask = labelled_mask(pair.texels, model, mask, pair.at)
        problem = posed(pair, mask, _usable(pair))
        start = np.asarray(model.coordinates(), np.float32)
        settled, _ = settle(start, problem, problem.observe(2 * SEARCH_PIXELS))
        if best is not None and settled.sigma > BETTER * best.settled.sigma:
            if settled.sigma < best.settled.sigma:
                best = Turned(problem, settled)
            break
        best = Turned(problem, settled)
        model = problem.at(settled.coordinates)
    return best


def _usable(pair: Pair) -> np.ndarray:
    """(h, w) texels that are not beside clipped ones."""
    clipped = (pair.texels.sure == 0).any(-1)
    return np.logical_not(ndimage.binary_dilation(clipped, iterations=BESIDE_CLIPPED))


def _refined(turned: Turned) -> Found:
    """The numbers of the exact taps, by all pixels."""
    problem = turned.problem
    observation = problem.picture.observe(pixels_used(problem.picture, problem.seed))
    settled, tangent = settle(turned.settled.coordinates, problem, observation)
    # An estimated mask takes up a part of what is wrong, so that curvature says too little: on a
    # real frame the light was ten such errors off.
    return Found(
        problem, observation, settled, evidence(settled, tangent, observation),
        opened=all_open(problem), inquire=False, objection=EXPLAINED, mask_estimated=True,
    )  # fmt: skip


def all_open(problem: Problem) -> tuple[tuple[int, list[int]], ...]:
    """Every coordinate, each without an error."""
    return tuple((i, []) for i in range(len(problem.names)))


def _unrefined(pair: Pair, posed) -> Found:
    """Where the search led, without errors, and that this is no fit."""
    problem = posed(pair, pair.mask, _usable(pair))
    start = np.asarray(pair.model.coordinates(), np.float32)
    observation = problem.observe(2 * SEARCH_PIXELS)
    tangent = tangent_at(start, problem, observation)
    sigma, likelihood = best_sigma(tangent.prediction, observation)
    settled = Settled(start, sigma, likelihood, True)
    words = pair.objection or "the mask that was found does not explain the pair to the byte"
    return Found(
        problem, observation, settled, evidence(settled, tangent, observation),
        opened=all_open(problem),
        inquire=False, objection=f"{words}; {NEXT}", mask_estimated=True,
    )  # fmt: skip
