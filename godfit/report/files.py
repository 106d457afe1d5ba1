"""The folder of a result: its record as JSON, its figure, and images."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from godfit.errors import InputError
from godfit.report.drawing import png_of
from godfit.report.sheet import Sheet
from godfit.runtime.files import atomic_write
from godfit.runtime.parallel import parallel_map

PAGE = "report.html"
"""The page of a result, in its folder."""


class PictureNotWritten(UserWarning):
    """A picture of a result could not be drawn or written; ``name`` is its file's."""

    def __init__(self, name: str, error: Exception) -> None:
        self.name = name
        reason = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        reason = str(error) if isinstance(error, InputError) else reason
        super().__init__(f"{name} was not written: {' '.join(str(reason).split())}")


def write_result(
    folder: Path,
    record: tuple[str, Mapping[str, Any]],
    figure: tuple[str, Callable[[], Sheet]],
    images: Mapping[str, Callable[[Path], None]] | None = None,
) -> None:
    """Write a result into ``folder``, which is made if need be.

    **Arguments:**

    - `record`: the name of the JSON file and what it holds. It is written first, so that no
      failure of a picture loses the numbers.
    - `figure`: the name of the PNG file and what makes its sheet.
    - `images`: names of further files, each with what writes it to a path.

    Each file appears whole or not at all, and other files in the folder stay. Raises OSError where
    the record cannot be written. A picture that fails is warned of (``PictureNotWritten``).
    """
    folder.mkdir(parents=True, exist_ok=True)
    name, values = record
    # A name that is not UTF-8 has lone surrogates: escaped, they are JSON and can be read again.
    text = json.dumps(values, indent=1, ensure_ascii=False) + "\n"
    atomic_write(folder / name, text.encode(errors="backslashreplace"))

    def draw(path: Path) -> None:
        atomic_write(path, png_of(figure[1]()))

    def failure(item: tuple[str, Callable[[Path], None]]) -> PictureNotWritten | None:
        name, write = item
        try:
            write(folder / name)
        except Exception as error:
            return PictureNotWritten(name, error)
        return None

    pictures = [(figure[0], draw), *(images or {}).items()]
    for failed in parallel_map(failure, pictures):
        if failed is not None:
            warnings.warn(failed, stacklevel=3)


def page_writer(page: Callable[[], str]) -> Callable[[Path], None]:
    """What writes a page to a path, whole or not at all."""

    def write(path: Path) -> None:
        atomic_write(path, page().encode("utf-8", "backslashreplace"))

    return write
