"""What conventions have in common: the numbers of the general sum over taps that each fixes.

Conventions that fix the same numbers give the same pictures, with numbers of samples that give as
many taps.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

from godfit.scattering.conventions import CONVENTIONS, Convention


class Form(NamedTuple):
    """The numbers of a sum that its convention fixes, None where free: ``own``, the weight of the
    pixel itself; ``ratio`` of a tap to the one before; ``relative``, the first tap's weight over
    the pixel's own; ``end``, the place of the last tap."""

    own: float | None = None
    ratio: float | None = None
    relative: float | None = None
    end: float | None = None

    @property
    def free(self) -> int:
        """How many of the four are free; without an own pixel, no weight is relative to it."""
        without_own = 1 if self.own == 0 else 0
        return sum(number is None for number in self) - without_own


def form_of(shader: Convention) -> Form | None:
    """The numbers that a convention fixes; None where it is no single sum over taps."""
    if not shader.plain:
        return None
    passes = shader.taps(0.3, 0.9, 0.7, 0.5, shader.samples)
    taps, other = passes[0], shader.taps(0.6, 0.9, 0.7, 0.5, shader.samples)[0]
    if taps.unit != "ray" or float(taps.lag) != 0:
        return None
    own, first = float(taps.own), float(taps.first)
    fixed, given = own == float(other.own), shader.parameters
    return Form(
        round(own, 6) if fixed else None,
        None if "decay" in given else round(float(taps.ratio), 6),
        None if "weight" in given or fixed else round(first / own, 6),
        None if "density" in given else round(float(taps.end), 6),
    )


@functools.cache
def forms() -> dict[Form, list[Convention]]:
    """The conventions that are single sums, by the numbers that they fix."""
    found: dict[Form, list[Convention]] = {}
    for shader in CONVENTIONS.values():
        form = form_of(shader)
        if form is not None:
            found.setdefault(form, []).append(shader)
    return found


def count_of(shader: Convention, samples: int) -> int:
    """The number of taps of a shader of ``samples`` that is a single sum."""
    return int(shader.count(samples))


class Named(NamedTuple):
    """A convention by name with a number of samples; ``default`` where that is its own."""

    shader: str
    samples: int
    default: bool

    def words(self) -> str:
        return f"{self.shader} with {self.samples} samples"


def named(form: Form, count: int, given: str = "") -> list[Named]:
    """The conventions that are a sum of ``count`` taps of a ``form``, likeliest first: those whose
    default it is, those with a round number of samples, then the one that was ``given``."""
    found = []
    for shader in forms().get(form, []):
        samples = count + shader.samples - count_of(shader, shader.samples)
        if samples >= 2 and count_of(shader, samples) == count:
            found.append(Named(shader.name, samples, samples == shader.samples))
    return sorted(found, key=lambda n: (not n.default, n.samples % 10 != 0, n.shader != given))
