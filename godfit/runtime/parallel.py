"""Independent pieces of work, each too small for every core, on a thread a core."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax
import numpy as np

Item = TypeVar("Item")
Result = TypeVar("Result")


def cores() -> int:
    """Those that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def parallel_map(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """``work`` of every item, in their order. In single precision, as the program is: JAX's
    settings are a thread's own."""
    return list(parallel_imap(work, items))


def map_halves(
    work: Callable[[np.ndarray], Iterable], items: np.ndarray, share: int = 1
) -> tuple[np.ndarray, ...]:
    """What ``work`` makes of ``items`` (n, ...), arrays (n, ...), from half of them on each of two
    cores. Halves are equal and a multiple of ``share`` long, the last item comes more than once:
    for another number a program would be compiled anew."""
    each = share * -(-len(items) // (2 * share))
    rows = np.arange(2 * each).clip(max=len(items) - 1).reshape(2, each)
    halves = parallel_map(lambda half: [np.asarray(z) for z in work(items[half])], rows)
    return tuple(np.concatenate(both)[: len(items)] for both in zip(*halves, strict=True))


def parallel_imap(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """As ``parallel_map``, but each result as soon as it is there: the others are worked on while
    it is used."""

    def single(item: Item) -> Result:
        with jax.enable_x64(False):
            return work(item)

    items = list(items)
    threads = min(cores(), len(items))
    if threads < 2:
        yield from map(single, items)
        return
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(single, items)
