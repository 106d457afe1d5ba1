"""Independent pieces of work, each too small for every core, on one thread per core."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from godfit.runtime.guest import own_settings
from godfit.runtime.one_core import cores

Item = TypeVar("Item")
Result = TypeVar("Result")


def parallel_map(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """``work`` of every item, in the items' order, computed in single precision."""
    return list(parallel_imap(work, items))


def map_halves(
    work: Callable[[np.ndarray], Iterable], items: np.ndarray, multiple_of: int = 1
) -> tuple[np.ndarray, ...]:
    """The arrays (n, ...) that ``work`` returns for ``items`` (n, ...), one half of the items on
    each of two cores.

    Both halves have one length, a multiple of ``multiple_of``: the last item is repeated, because
    another length would compile another program.
    """
    length = multiple_of * -(-len(items) // (2 * multiple_of))
    rows = np.arange(2 * length).clip(max=len(items) - 1).reshape(2, length)
    halves = parallel_map(lambda half: [np.asarray(z) for z in work(items[half])], rows)
    return tuple(np.concatenate(both)[: len(items)] for both in zip(*halves, strict=True))


def parallel_imap(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """As ``parallel_map``, but yields each result when it is ready, while the threads compute the
    later ones."""

    def in_single_precision(item: Item) -> Result:
        # Settings belong to a thread, so a new thread does not have the caller's.
        with own_settings():
            return work(item)

    items = list(items)
    threads = min(cores(), len(items))
    if threads < 2:
        yield from map(in_single_precision, items)
        return
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(in_single_precision, items)
