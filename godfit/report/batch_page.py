"""One page for a whole batch: parameters over frames, outliers, thumbnails, and a table that is
sorted and filtered in the browser. It opens offline, and shows ten thousand frames."""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from godfit.report.outliers import OUTLYING, outlying

TILE = (48, 32)
"""Width and height of a thumbnail on the page, in pixels."""
ACROSS = 100
"""Thumbnails in a row of the image that holds them all."""
ATLAS_BYTES = 4 << 20
"""Largest image of thumbnails, in bytes: a page of ten thousand frames is then below 10 MB."""
MAX_TILES = 50_000
"""Most thumbnails on the page: a side of a WebP has at most 16,383 pixels."""
QUALITIES = (70, 40, 20, 5, 0)
"""Qualities of WebP in turn, until the image of thumbnails is small enough."""
DIGITS = 9
"""Digits of estimates on the page, as many as float32 has."""
ERROR_DIGITS = 3
"""Digits of standard errors on the page."""


class PageRow(NamedTuple):
    """A line of the page: the frame, how its fit ended, the estimates as in fit.json by name, a
    remark, and a thumbnail as the bytes of an image (empty for none)."""

    path: str
    status: str
    numbers: Mapping[str, Mapping[str, Any]]
    remark: str = ""
    thumbnail: bytes = b""


def page(rows: Sequence[PageRow], title: str) -> bytes:
    """The page as UTF-8."""
    names = list(dict.fromkeys(name for row in rows for name in row.numbers))
    columns = {name: _column(rows, name) for name in names}
    atlas, places = _atlas([row.thumbnail for row in rows])
    counts = {
        s: sum(row.status == s for row in rows) for s in dict.fromkeys(r.status for r in rows)
    }
    data = {
        "title": title,
        "summary": f"{len(rows)} frames: " + ", ".join(f"{n} {s}" for s, n in counts.items()),
        "statuses": sorted(counts),
        "path": [row.path for row in rows],
        "status": [row.status for row in rows],
        "remark": [row.remark for row in rows],
        "numbers": {
            name: {"value": _rounded(value, DIGITS), "error": _rounded(error, ERROR_DIGITS)}
            for name, (value, error) in columns.items()
        },
        "outliers": _outliers(columns),
        "thumb": places,
        "atlas": atlas,
        "across": ACROSS,
        "tile": TILE,
    }
    # A name that ends the script early, or begins a comment of HTML, is escaped.
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    template = Path(__file__).with_suffix(".html").read_text(encoding="utf-8")
    return template.replace("@DATA@", text).encode(errors="backslashreplace")


def _column(rows: Sequence[PageRow], name: str) -> tuple[np.ndarray, np.ndarray]:
    """(n,) values and (n,) standard errors of a parameter, NaN where there are none."""

    def numbers(key: str) -> np.ndarray:
        found = (row.numbers.get(name, {}).get(key) for row in rows)
        return np.array([math.nan if v is None else v for v in found], float)

    return numbers("value"), numbers("stderr")


def _rounded(values: Iterable[float], digits: int) -> list[float | None]:
    return [float(f"{v:.{digits}g}") if math.isfinite(v) else None for v in values]


def _outliers(columns: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> list[list[Any]]:
    """[row, parameter, errors] of the frames that differ from those around them, the farthest
    first."""
    found = []
    for name, (values, errors) in columns.items():
        away = outlying(values, errors)
        found += [[int(i), name, round(float(away[i]), 1)] for i in np.flatnonzero(away > OUTLYING)]
    return sorted(found, key=lambda entry: -entry[2])


def _atlas(thumbnails: Sequence[bytes]) -> tuple[str, list[int]]:
    """One image of all thumbnails as a data URL, and the place of each in it, -1 for none."""
    from PIL import Image

    different = list(dict.fromkeys(data for data in thumbnails if data))[:MAX_TILES]
    known = {data: i for i, data in enumerate(different)}
    places = [known.get(data, -1) for data in thumbnails]
    if not known:
        return "", places
    rows = -(-len(known) // ACROSS)
    whole = Image.new("RGB", (TILE[0] * min(ACROSS, len(known)), TILE[1] * rows))
    for data, i in known.items():
        try:
            with Image.open(io.BytesIO(data), formats=("WEBP",)) as small:
                tile = small.convert("RGB")
        except (OSError, ValueError):
            # A journal that something else has written.
            continue
        tile.thumbnail(TILE)
        whole.paste(tile, (TILE[0] * (i % ACROSS), TILE[1] * (i // ACROSS)))
    for quality in QUALITIES:
        out = io.BytesIO()
        whole.save(out, "WEBP", quality=quality)
        if out.tell() <= ATLAS_BYTES:
            break
    return f"data:image/webp;base64,{base64.b64encode(out.getvalue()).decode()}", places
