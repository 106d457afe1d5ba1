"""A search for a light that compares fewer pixels, for fits of which the search is but a part."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from godfit.blind import certainty, search

FEWER = {
    "COARSE_PAIRS": 300,
    "PAIRS": 700,
    "FINE_PAIRS": 2000,
    "NEAR_PAIRS": 1000,
    "GENERATIONS": 12,
}
"""Constants of the search: a third of its own, on pictures of a tenth of a screen's pixels."""


@pytest.fixture
def fewer_pairs() -> Iterator[None]:
    """No compiled program holds these numbers: stored ones serve, unlike with ``monkeypatch``."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in FEWER.items():
            patch.setattr(search, name, value)
        patch.setattr(certainty, "FINE_PAIRS", FEWER["FINE_PAIRS"])
        yield
