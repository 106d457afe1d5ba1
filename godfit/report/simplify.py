"""The result of ``godfit simplify``: a sentence, settings to paste, JSON."""

from __future__ import annotations

import dataclasses
from typing import Any

from godfit.models.mitchell import Mitchell


@dataclasses.dataclass(frozen=True, eq=False)
class Simpler:
    """The cheapest setting found: ``scale`` is that of the light pass's sides. ``worst`` and
    ``rms`` are its error in levels against ``full``; ``saving`` is how many times fewer taps a
    picture takes. ``tolerance`` is the error allowed, in levels, of the kind that ``by`` names,
    "worst" or "rms"."""

    full: Mitchell
    model: Mitchell
    scale: float
    worst: float
    rms: float
    saving: float
    tolerance: float
    by: str

    @property
    def sentence(self) -> str:
        """A sentence: how many samples the picture needs."""
        needed, given = self.model.samples, self.full.samples
        if self.saving == 1:
            return f"this picture needs all of its {given} samples"
        sentence = f"this picture needs {needed} samples, not {given}"
        if needed == given:
            sentence = f"this picture needs its {given} samples"
        if self.scale < 1:
            sentence += f", and a light pass of {self.scale:g} times the sides"
        return f"{sentence}: {self.saving:.3g} times fewer taps"

    def summary(self) -> str:
        """The sentence, and what to paste into the shader."""
        sentence = f"off by {self.worst:.3g} levels at most, {self.rms:.3g} rms"
        settings = [("samples", str(self.model.samples))]
        settings += [(name, f"{value:.9g}") for name, value in _numbers(self.model).items()]
        if self.scale < 1:
            settings.append(("pass scale", f"{self.scale:g}"))
        wide = max(len(name) for name, _ in settings)
        lines = [f"  {name:<{wide}} = {value}" for name, value in settings]
        return "\n".join([self.sentence, f"  ({sentence})", "", *lines])

    def record(self, command: str = "") -> dict[str, Any]:
        """What ``godfit simplify --json`` prints; ``godfit render --params`` reads it."""
        return {
            "schema": 1,
            "message": self.sentence,
            "model": self.model.name,
            "shader": self.model.convention.name,
            "samples": self.model.samples,
            "pass_scale": self.scale,
            "params": {name: {"value": value} for name, value in _numbers(self.model).items()},
            "tolerance_levels": self.tolerance,
            "by": self.by,
            "worst_levels": self.worst,
            "rms_levels": self.rms,
            "saving": self.saving,
            "full_samples": self.full.samples,
            "command": command,
        }


def _numbers(model: Mitchell) -> dict[str, float]:
    return {name: float(value) for name, value in model.values().items()}
