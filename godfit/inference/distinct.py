"""Those of many that differ: one of each minimum, one of each light."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np

Item = TypeVar("Item")


def distinct(
    items: Iterable[Item], same: Callable[[Item, Item], bool], most: int | None = None
) -> list[Item]:
    """The items, in their order, that are not the ``same`` as one that was kept before; at
    ``most`` so many."""
    kept: list[Item] = []
    for item in items:
        if most is not None and len(kept) == most:
            break
        if not any(same(item, other) for other in kept):
            kept.append(item)
    return kept


DOUBT = 8.0


def local_minima(costs: np.ndarray) -> np.ndarray:
    """Indices at which ``costs`` (n,) are finite and not above either neighbour."""
    costs = np.where(np.isfinite(costs), costs, np.inf)
    around = np.pad(costs, 1, constant_values=np.inf)
    return np.flatnonzero(np.isfinite(costs) & (costs <= around[:-2]) & (costs <= around[2:]))
