"""Which hypothesis a picture deserves, tried from least to most."""

from __future__ import annotations

import numpy as np

from godfit.blind.search import Candidate

VEIL_COST = -0.28
"""Misfit per pair, less that without light, from which a disc on a veil is believed. It has two
gains and a step more than a bright mask, and its clipped pixels are data: less is overfitting."""
LEAD, LEAD_IN_SIGHT = 1.3, 3.0
"""How many times as much it must explain as the bright mask: in general, and where that one's disc
is in the picture and elsewhere. A bright mask is right wherever its light is in sight, while a veil
may take ground and objects for one another."""
SAME_LIGHT = 0.02
"""Distance of the lights of two hypotheses, as a share of the picture, up to which they agree."""


def ordered(candidates: list[Candidate]) -> list[Candidate]:
    """The candidates, the chosen one first and the others by their misfits.

    Hypotheses have different pixels as data, so that their likelihoods have no criterion in common.
    Their misfits per pair compare, with a handicap for what explains more by itself.
    """
    by_cost = sorted(candidates, key=lambda c: c.cost)
    plain = next((c for c in by_cost if c.hypothesis.name == "bright"), None)
    best = by_cost[0]
    if plain is not None and (best.cost > VEIL_COST or best.cost > _lead(best, plain) * plain.cost):
        best = plain
    return [best, *(c for c in by_cost if c is not best)]


def _lead(veil: Candidate, bright: Candidate) -> float:
    h, w = bright.hypothesis.values.shape
    reach = bright.radius * max(h, w) / np.array([w, h])
    in_sight = np.all((reach <= bright.place) & (bright.place <= 1 - reach))
    elsewhere = distance(veil.place, bright.place) > SAME_LIGHT
    return LEAD_IN_SIGHT if in_sight and elsewhere else LEAD


def distance(one: tuple[float, float], other: tuple[float, float]) -> float:
    """The larger difference of two places, as a share of the picture."""
    return max(abs(a - b) for a, b in zip(one, other, strict=True))
