"""The result of ``godfit export``: code to paste, and how far its picture is from the fit's."""

from __future__ import annotations

import dataclasses
import textwrap

from godfit.report.engines.engine_code import COMMENTS
from godfit.scattering.engines import ENGINES, Engine

COMMENT_WIDTH = 96
"""Columns of a line of comment: with its mark it is a line of 100."""
EXACT_LEVELS = 1e-3
"""Largest difference, in levels, of two pictures that are the same up to rounding."""
KINDS = {
    "exact": "exact: the numbers are algebra",
    "near": "near: refitted, with its difference",
    "port": "ports of the fit's own shader",
}


@dataclasses.dataclass(frozen=True)
class Difference:
    """Levels between the fit's picture and the engine's: root mean square and worst, and the worst
    of their bytes."""

    rms: float
    worst: float
    worst_byte: int


@dataclasses.dataclass(frozen=True)
class Export:
    """An engine, the ``code`` to paste, the parameters of its sum, whether they are algebra, the
    ``difference`` of the pictures (None where nothing was rendered), and ``notes``."""

    engine: Engine
    code: str
    values: dict[str, float]
    by_algebra: bool
    difference: Difference | None
    notes: tuple[str, ...]

    def text(self) -> str:
        """The code, under comments that say what makes it exact and how far off it is."""
        mark = COMMENTS.get(self.engine.template, "//")
        said = [self.engine.title + ": " + self.sentence(), *self.notes]
        lines = [line for text in said for line in textwrap.wrap(text, COMMENT_WIDTH)]
        comments, code = [f"{mark} {line}" for line in lines], self.code.rstrip().splitlines()
        # GLSL ES has its version in the first line.
        first = [code.pop(0)] if code[0].startswith("#version") else []
        return "\n".join([*first, *comments, *code]) + "\n"

    def sentence(self) -> str:
        """How the picture compares with the fit's."""
        if self.engine.kind == "port":
            return "the fit's own formula and numbers, the same picture up to rounding"
        how = "translated" if self.by_algebra else "refitted"
        if self.difference is None:
            return f"{how}; not rendered, as the fit's mask is not here"
        off = self.difference
        if off.worst <= EXACT_LEVELS:
            return f"{how}; the same picture, {off.worst:.1g} levels off at worst"
        return (
            f"{how}; {off.rms:.2g} levels rms and {off.worst:.3g} at worst from the fit, bytes up "
            f"to {off.worst_byte} apart"
        )


def list_text() -> str:
    """The engines by kind, with their names, titles and what makes them exact."""
    wide, lines = max(map(len, ENGINES)), []
    for kind, title in KINDS.items():
        lines += ["" if lines else None, f"# {title}"]
        lines += [
            f"  {engine.name:<{wide}}  {engine.title}"
            for engine in ENGINES.values()
            if engine.kind == kind
        ]
    return "\n".join(line for line in lines if line is not None)
