"""Which hypothesis a picture deserves, tried from least to most."""

from __future__ import annotations

from godfit.blind.search import Candidate

VEIL_COST = -0.28
"""Misfit per pair, less that without light, from which a disc on a veil is believed. It has two
gains and a step more than a bright mask, and its clipped pixels are data: less is overfitting."""
VEIL_LEAD = 1.3
"""How many times as much it must explain as the bright mask."""


def ordered(candidates: list[Candidate]) -> list[Candidate]:
    """The candidates, the chosen one first and the others by their misfits.

    Hypotheses have different pixels as data, so that their likelihoods have no criterion in common.
    Their misfits per pair compare, with a handicap for what explains more by itself.
    """
    by_cost = sorted(candidates, key=lambda c: c.cost)
    plain = next((c for c in by_cost if c.hypothesis.name == "bright"), None)
    best = by_cost[0]
    if plain is not None and (best.cost > VEIL_COST or best.cost > VEIL_LEAD * plain.cost):
        best = plain
    return [best, *(c for c in by_cost if c is not best)]
