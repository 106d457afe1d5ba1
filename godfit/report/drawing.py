"""A sheet as a PNG, drawn by a companion process where one was started.

To import matplotlib takes a sixth of a short command, and drawing half as long. The companion does
both beside the fit, which uses one core while it imports JAX.
"""

from __future__ import annotations

import io
import pickle
import sys
from collections.abc import Callable

import numpy as np

from godfit.report.sheet import DPI, INK, Grid, Panel, Sheet, Words, picture
from godfit.report.style import own_style
from godfit.runtime.companion import Companion

SMALL_ENOUGH = {"compress_level": 3}
"""How a figure is compressed: a tenth more bytes than at zlib's usual level 6, in half the time."""

_companions: list[Companion] = []
"""The companion that waits for a sheet."""


def draw_ahead() -> bool:
    """Start a companion for the next sheet, where this process has not loaded matplotlib; whether
    one waits."""
    if not _companions and "matplotlib" not in sys.modules:
        companion = Companion.start(f"{__name__}:_png_for")
        _companions.extend([companion] if companion else [])
    return bool(_companions)


def png_of(sheet: Sheet) -> bytes:
    """The sheet's figure as a PNG, by the companion that waits or here."""
    if _companions:
        companion = _companions.pop()
        companion.send(pickle.dumps(sheet))
        answer = companion.answer()
        if answer:
            return answer
    return _drawn(sheet)


def _drawn(sheet: Sheet) -> bytes:
    content = io.BytesIO()
    with own_style():
        sheet.figure().savefig(content, format="png", dpi=DPI, pil_kwargs=SMALL_ENOUGH)
    return content.getvalue()


def _png_for(request: Callable[[], bytes]) -> bytes:
    """What the companion does. A first sheet loads fonts and colours before there is a result."""
    blank = Panel("-", picture(np.zeros((2, 2))), (("-", INK),), 1.0)
    _drawn(Sheet("-", True, (Grid((blank,), 1.0), Words((("-", INK),), mono=True))))
    return _drawn(pickle.loads(request()))
