"""Independent pieces of work, each too small for every core, on a thread a core."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax

Item = TypeVar("Item")
Result = TypeVar("Result")


def cores() -> int:
    """Those that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def side_by_side(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """``work`` of every item, in their order. In single precision, as the program is: JAX's
    settings are a thread's own."""
    return list(ahead(work, items))


def ahead(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """As ``side_by_side``, but each result as soon as it is there: the others are worked on while
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
