"""The folder of a result: its record as JSON, its figure, and images."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from godfit.runtime.files import atomic_write
from godfit.runtime.parallel import parallel_map

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 100
"""Pixels an inch of a figure: panels of 4 inches hold pictures of 400 pixels without scaling."""


def write_result(
    folder: Path,
    record: tuple[str, Mapping[str, Any]],
    figure: tuple[str, Callable[[], Figure]],
    images: Mapping[str, Callable[[Path], None]] | None = None,
) -> None:
    """Write a result into ``folder``, which is made if need be.

    **Arguments:**

    - `record`: the name of the JSON file and what it holds. It is written first, so that no
      failure of a picture loses the numbers.
    - `figure`: the name of the PNG file and what draws it.
    - `images`: names of further files, each with what writes it to a path.

    Each file appears whole or not at all, and other files in the folder stay. Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    name, values = record
    text = json.dumps(values, indent=1, ensure_ascii=False) + "\n"
    atomic_write(folder / name, text.encode())

    def draw() -> None:
        drawn = io.BytesIO()
        figure[1]().savefig(drawn, format="png", dpi=DPI)
        atomic_write(folder / figure[0], drawn.getvalue())

    def write(item: tuple[str, Callable[[Path], None]]) -> Callable[[], None]:
        return lambda: item[1](folder / item[0])

    parallel_map(lambda work: work(), [draw, *map(write, (images or {}).items())])
