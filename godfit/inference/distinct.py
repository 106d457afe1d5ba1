"""Candidates that differ: one of each minimum, one of each light."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np

Item = TypeVar("Item")


def distinct(
    items: Iterable[Item], same: Callable[[Item, Item], bool], limit: int | None = None
) -> list[Item]:
    """The items, in their order, without those that are the ``same`` as an earlier one; at most
    ``limit``."""
    distinct_items: list[Item] = []
    for item in items:
        if limit is not None and len(distinct_items) == limit:
            break
        if not any(same(item, other) for other in distinct_items):
            distinct_items.append(item)
    return distinct_items


DOUBT = 8.0
"""Difference in log-likelihood up to which another candidate may be the better one: the candidates
were compared on a sample of the pixels."""


def local_minima(costs: np.ndarray) -> np.ndarray:
    """Indices at which ``costs`` (n,) are finite and not above either neighbour."""
    costs = np.where(np.isfinite(costs), costs, np.inf)
    around = np.pad(costs, 1, constant_values=np.inf)
    return np.flatnonzero(np.isfinite(costs) & (costs <= around[:-2]) & (costs <= around[2:]))
