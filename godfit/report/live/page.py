"""The one writer of pages: a title, a verdict, viewers and tables, in one file that opens offline.

Style and program are inlined, and a content policy forbids every request.
"""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Section:
    """A part of a page: a heading and its HTML; ``viewer`` is the data of a viewer above it, as of
    ``data.page_data``."""

    title: str
    body: str = ""
    viewer: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Page:
    """A page: its title, one sentence on the result, whether that is good, and the sections."""

    title: str
    verdict: str
    good: bool
    sections: tuple[Section, ...]

    def html(self) -> str:
        """The whole file."""
        viewers = [section.viewer for section in self.sections if section.viewer is not None]
        parts, count = [], 0
        for section in self.sections:
            place = ""
            if section.viewer is not None:
                place, count = f'<div class="viewer" data-viewer="{count}"></div>', count + 1
            parts.append(
                f"<section><h2>{html.escape(section.title)}</h2>{place}{section.body}</section>"
            )
        values = {
            "title": html.escape(self.title),
            "verdict": html.escape(self.verdict),
            "state": "good" if self.good else "bad",
            "sections": "\n".join(parts),
            "style": _source("style.css"),
            "viewer": _source("viewer.js"),
            # Inside a script element only its end tag and comments have a meaning.
            "data": json.dumps(viewers, allow_nan=False).replace("<", "\\u003c"),
        }
        # In one pass: a title may hold the name of another slot.
        return re.sub(r"\[\[(\w+)\]\]", lambda slot: values[slot[1]], _source("template.html"))


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """An HTML table; numbers stand at the right."""

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(f"<{tag}>{html.escape(str(cell))}</{tag}>" for cell in row)

    lines = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f'<div class="wide"><table><tr>{cells("th", head)}</tr>{lines}</table></div>'


def sentences(lines: Iterable[str]) -> str:
    """A list of sentences, empty without any."""
    items = "".join(f"<li>{html.escape(str(line))}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def plain(text: str) -> str:
    """Text as it is printed."""
    return f"<pre>{html.escape(text)}</pre>"


def framed(page: str) -> str:
    """A page inside another one, as a notebook holds it."""
    style = "width: 100%; height: 640px; border: 0"
    return f'<iframe style="{style}" srcdoc="{html.escape(page)}"></iframe>'


def _source(name: str) -> str:
    return (HERE / name).read_text(encoding="utf-8")
