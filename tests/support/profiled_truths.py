"""Random truths, at a bound or not, each fitted without a hint and one parameter of it profiled."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from godfit import FitResult, fit
from godfit.studies.profile_likelihood import profile
from tests.support import random_targets

SAMPLES = 60
PROFILED = ("decay", "density")


class Profiled(NamedTuple):
    """An interval (2,) of the parameter whose true value is ``truth``."""

    result: FitResult
    name: str
    truth: float
    interval: tuple[float, float]

    @property
    def covers(self) -> bool:
        # A bound is in float32.
        return self.interval[0] <= self.truth <= self.interval[1] + 1e-7


def attempt(
    seed: int, name: str, noise: float, size: int, at: float | None = None, **options: Any
) -> Profiled:
    """A picture fitted with ``options``, ``name`` profiled; its truth is ``at``, or drawn."""
    kind = random_targets.FRESH[seed % len(random_targets.FRESH)]
    mask, _, truth = random_targets.draw(seed, kind, size, SAMPLES)
    if at is not None:
        truth[name] = at
    linear = random_targets.render64(mask / 255, truth | {"exposure": 1.0})
    truth["exposure"] = 1 / float(np.quantile(linear, 0.98))
    target = random_targets.to_bytes(linear * truth["exposure"], noise, seed)
    result = fit(target, mask=mask, shader="dawntime", samples=SAMPLES, **options)
    interval = profile(result, name).params[name].interval
    assert interval is not None
    return Profiled(result, name, truth[name], interval)
