"""Candidates for an answer, from few pixels, held against each other on all of them."""

from __future__ import annotations

import numpy as np

from godfit.inference.information import Evidence, evidence
from godfit.inference.noise import EXPLAINED
from godfit.inference.observation import Observation, Picture
from godfit.inference.repeated_values import counted_once
from godfit.inference.settle import Settled, settle
from godfit.models.mitchell import AbstractModel
from godfit.search import density_minima


def likeliest(
    picture: Picture,
    model: AbstractModel,
    candidates: list[np.ndarray],
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
) -> tuple[Settled, Evidence, Observation]:
    """The likeliest of the candidates and, where density is in doubt, of the dips around them, on
    all pixels of ``seen``; flat areas are counted once in the end."""
    if len(candidates) == 1:
        settled, tangent, counted = counted_once(candidates[0], model, seen, free, held, [])
        at = evidence(settled, tangent, counted)
        if not (model.banded and density_minima.in_doubt(settled, at, model, free)):
            return settled, at, counted
        candidates = [settled.coordinates]
        # The derivatives of every pixel would only fill the memory.
        del tangent
    settled, tangent = max(
        (settle(z, model, seen, free, held) for z in candidates),
        key=lambda found: found[0].log_likelihood,
    )
    at = evidence(settled, tangent, seen)
    first, known = settled, [tangent]
    del tangent
    settled, at = density_minima.next_dips(settled, at, model, seen, free, held)
    settled, at = density_minima.beat_rivals(settled, at, model, picture, seen, free, held, seed)
    settled, at = density_minima.beat_distant(settled, at, model, picture, seen, free, held, seed)
    if settled.sigma > EXPLAINED:
        return settled, at, seen
    if settled is not first:
        known.clear()
    settled, tangent, counted = counted_once(settled.coordinates, model, seen, free, held, known)
    return settled, evidence(settled, tangent, counted), counted
