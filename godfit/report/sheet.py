"""The one layout of all figures: a title, a grid of pictures or charts, tables and sentences.

Everything is placed in inches from measured texts. Texts are wrapped to their column, so that
nothing overlaps and nothing is cut whatever the shape of the pictures. matplotlib's own layouts
draw everything several times, and give up on small panels.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 100
"""Pixels an inch of a figure."""
WIDEST = 13.0
"""Width of a sheet in inches, at most: that of a screen."""
TALLEST = 8.0
"""Height of a grid of pictures in inches, at most, so that a sheet fits on a screen."""
LEAST_CELL = 2.3
"""Width of a cell in inches, at least: the words of a title fit beside each other."""
LEAST_SHEET = 7.5
"""Width of a sheet in inches, at least: a row of the table fits."""
LEAST_SIDE = 0.25
"""Shorter side of a picture in inches, at least: that of a picture 30 times longer than wide."""
MARGIN = 0.25
"""Inches around the sheet and between its cells."""
GAP = 0.1
"""Inches between a picture and its texts."""
LINE = 1.3
"""Height of a line, as a share of the font's size."""
POINTS = 72.0
"""Points in an inch."""
KERNING = 0.985
"""Share of a line that measured words may fill: a whole line may be a little wider than they."""
MUCH_LARGER = 1.5
"""Ratio of a picture's area from which another row is worth its place."""
BAR = 0.12
"""Height of a bar of colours in inches."""
SIZES = {"title": 12.0, "head": 10.5, "text": 9.0, "mono": 9.0}
"""Sizes of the fonts in points, by use."""
DIMMED = 0.35
"""Brightness of a picture under maps, so that their colours are visible."""
SIGNED = "RdBu_r"
"""Colours of a residual: blue below, red above."""
INK, ALARM, QUIET = "black", "firebrick", "#444444"
"""Colours of texts: ordinary ones, bad news, captions."""

Line = tuple[str, str]
"""A text and its colour."""


@dataclass(frozen=True)
class Panel:
    """A cell of a grid: ``draw`` fills its axes; ``bar`` is the level at either end of its colours,
    0 without. ``captions`` stand below it. Charts (``ticks``) keep room for their labels."""

    title: str
    draw: Callable[[Any], Any]
    captions: tuple[Line, ...] = ()
    bar: float = 0.0
    ticks: bool = False
    strong: bool = False


@dataclass(frozen=True)
class Grid:
    """Panels whose pictures have the shape ``aspect``, height over width."""

    panels: tuple[Panel, ...]
    aspect: float


@dataclass(frozen=True)
class Words:
    """Sentences below each other, or rows of a table in columns (``mono``)."""

    lines: tuple[Line, ...]
    mono: bool = False


@dataclass(frozen=True)
class Sheet:
    """A figure: its title, whether the news is good, and its blocks from top to bottom."""

    title: str
    good: bool
    blocks: tuple[Grid | Words, ...] = field(default=())

    def figure(self) -> Figure:
        """The figure, with a canvas of its own."""
        # Without pyplot: it would open a window system, and its figures have to be closed.
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        from godfit.report.shown_figure import ShownFigure

        grids = [_placed(block) for block in self.blocks if isinstance(block, Grid)]
        width = max([LEAST_SHEET, *(grid.width for grid in grids)])
        room = width - 2 * MARGIN
        title = wrapped(self.title, room, "title")
        blocks: list[_Cells | list[Column]] = []
        heights = [_height(len(title), "title")]
        for block in self.blocks:
            if isinstance(block, Grid):
                placed = grids.pop(0)
                blocks.append(placed)
                heights.append(placed.height)
            else:
                columns = _columns(block, room)
                blocks.append(columns)
                most = max((len(column.lines) for column in columns), default=0)
                heights.append(_height(most, "mono" if block.mono else "text"))
        whole = sum(heights) + MARGIN * (len(heights) + 1)
        figure = ShownFigure(figsize=(width, whole), dpi=DPI)
        FigureCanvasAgg(figure)
        pen = Pen(figure, width, whole)
        top = whole - MARGIN
        pen.write(Column("title", MARGIN, [(t, INK if self.good else ALARM) for t in title]), top)
        top -= heights[0]
        for block, height in zip(blocks, heights[1:], strict=True):
            top -= MARGIN
            if isinstance(block, _Cells):
                block.draw(pen, top)
            else:
                for column in block:
                    pen.write(column, top)
            top -= height
        return figure


@dataclass(frozen=True)
class Column:
    """Lines below each other, of one font, from ``left`` in inches."""

    font: str
    left: float
    lines: Sequence[Line]
    bold: bool = False


@dataclass(frozen=True)
class Pen:
    """Writes and places on a figure of ``width`` x ``height`` inches, measured from below."""

    figure: Figure
    width: float
    height: float

    def write(self, column: Column, top: float) -> None:
        """The lines of a column, the first one's top at ``top``."""
        step = SIZES[column.font] * LINE / POINTS
        for i, (text, colour) in enumerate(column.lines):
            if text:
                # Names of files may hold dollars, which are no mathematics.
                self.figure.text(
                    column.left / self.width, (top - i * step) / self.height, text, va="top",
                    color=colour, fontproperties=_font(column.font, column.bold), parse_math=False,
                )  # fmt: skip

    def axes(self, left: float, bottom: float, width: float, height: float) -> Any:
        """Axes at a place in inches."""
        at = (left / self.width, bottom / self.height, width / self.width, height / self.height)
        return self.figure.add_axes(at)


TICK_ROOM = (0.85, 0.3)
"""Inches at the left of and below a chart for the labels of its ticks."""


@dataclass(frozen=True)
class _Cells:
    """A grid that was placed: cells of ``cell`` inches width with pictures of ``size``."""

    grid: Grid
    columns: int
    cell: float
    size: tuple[float, float]

    @property
    def width(self) -> float:
        return self.columns * (self.cell + MARGIN) + MARGIN

    @property
    def rows(self) -> list[tuple[Panel, ...]]:
        panels = self.grid.panels
        return [panels[i : i + self.columns] for i in range(0, len(panels), self.columns)]

    def head(self, panel: Panel) -> tuple[str, ...]:
        return wrapped(panel.title, self.cell, "head", panel.strong)

    def captions(self, panel: Panel) -> list[Line]:
        pairs = ((wrapped(text, self.cell, "text"), colour) for text, colour in panel.captions)
        return [(line, colour) for lines, colour in pairs for line in lines]

    def parts(self, row: tuple[Panel, ...]) -> tuple[float, float, float]:
        """Heights of the titles, of what is between picture and captions, and of the captions."""
        heads = _height(max(len(self.head(panel)) for panel in row), "head") + GAP / 2
        bars = GAP + BAR + _height(1, "text") + GAP if any(p.bar for p in row) else GAP / 2
        bars = max(bars, TICK_ROOM[1] if any(p.ticks for p in row) else 0)
        return heads, bars, _height(max(len(self.captions(panel)) for panel in row), "text")

    @property
    def height(self) -> float:
        return sum(sum(self.parts(row)) + self.size[1] + MARGIN for row in self.rows) - MARGIN

    def draw(self, pen: Pen, top: float) -> None:
        """All panels, the first row's top at ``top``."""
        for row in self.rows:
            heads, bars, captions = self.parts(row)
            for i, panel in enumerate(row):
                left = MARGIN + i * (self.cell + MARGIN)
                lines = [(text, INK) for text in self.head(panel)]
                pen.write(Column("head", left, lines, panel.strong), top)
                self._panel(pen, panel, left, top - heads)
                below = top - heads - self.size[1] - bars
                pen.write(Column("text", left, self.captions(panel)), below)
            top -= heads + self.size[1] + bars + captions + MARGIN

    def _panel(self, pen: Pen, panel: Panel, left: float, top: float) -> None:
        wide, tall = self.size
        room = TICK_ROOM[0] if panel.ticks else 0.0
        axes = pen.axes(left + room, top - tall, wide - room, tall)
        if not panel.ticks:
            # Ticks that nobody sees would still be made.
            axes.xaxis.set_visible(False)
            axes.yaxis.set_visible(False)
        panel.draw(axes)
        if panel.bar:
            self._bar(pen, panel.bar, left, top - tall - GAP)

    def _bar(self, pen: Pen, end: float, left: float, top: float) -> None:
        """The colours from -``end`` to ``end`` levels, with their numbers below."""
        long = min(self.cell, max(self.size[0], LEAST_CELL))
        axes = pen.axes(left, top - BAR, long, BAR)
        axes.set_axis_off()
        axes.imshow(np.linspace(-1, 1, 255)[None], cmap=SIGNED, aspect="auto")
        for share, text in ((0.0, f"{-end:+.2g}"), (0.5, "0"), (1.0, f"{end:+.2g}")):
            at = left + share * (long - measured(text, "text"))
            pen.write(Column("text", at, [(text, INK)]), top - BAR - GAP / 4)


def _placed(grid: Grid) -> _Cells:
    """As many columns as fit, and fewer where that makes the pictures much larger."""
    best, count = None, len(grid.panels)
    for columns in range(count, 0, -1):
        cell = (WIDEST - MARGIN) / columns - MARGIN
        if cell < LEAST_CELL and columns > 1:
            continue
        rows = -(-count // columns)
        wide = min(cell, TALLEST / rows / grid.aspect)
        size = max(wide, LEAST_SIDE), max(wide * grid.aspect, LEAST_SIDE)
        found = _Cells(grid, columns, max(min(cell, size[0]), LEAST_CELL), size)
        if best is None or size[0] * size[1] > MUCH_LARGER * best.size[0] * best.size[1]:
            best = found
    assert best is not None
    return best


def _columns(words: Words, room: float) -> list[Column]:
    """The lines in as many columns as have room, or wrapped in one."""
    font = "mono" if words.mono else "text"
    if not words.mono:
        lines = [
            (part, colour) for text, colour in words.lines for part in wrapped(text, room, font)
        ]
        return [Column(font, MARGIN, lines)]
    widest = max((measured(text, font) for text, _ in words.lines), default=0.0) + MARGIN
    count = max(1, min(int(room / widest) if widest else 1, len(words.lines)))
    if widest > room + MARGIN:
        lines = [
            (part, colour) for text, colour in words.lines for part in wrapped(text, room, font)
        ]
        return [Column(font, MARGIN, lines)]
    each = -(-len(words.lines) // count)
    return [
        Column(font, MARGIN + i * room / count, words.lines[i * each : (i + 1) * each])
        for i in range(count)
    ]


def _height(lines: int, font: str) -> float:
    return lines * SIZES[font] * LINE / POINTS


@functools.cache
def _font(font: str, bold: bool = False) -> Any:
    from matplotlib.font_manager import FontProperties

    family = "DejaVu Sans Mono" if font == "mono" else "DejaVu Sans"
    return FontProperties(family=family, size=SIZES[font], weight="bold" if bold else "normal")


@functools.cache
def _renderer() -> Any:
    from matplotlib.backends.backend_agg import RendererAgg

    return RendererAgg(8, 8, DPI)


@functools.lru_cache(4096)
def measured(text: str, font: str, bold: bool = False) -> float:
    """The width of a text in inches."""
    return _renderer().get_text_width_height_descent(text, _font(font, bold), False)[0] / DPI


@functools.lru_cache(256)
def wrapped(text: str, room: float, font: str, bold: bool = False) -> tuple[str, ...]:
    """The text in lines of at most ``room`` inches; words that are longer are cut."""
    lines: list[str] = []
    blank = measured("m m", font, bold) - 2 * measured("m", font, bold)
    for paragraph in text.splitlines():
        line, long = "", 0.0
        for word in paragraph.split(" "):
            # Words are measured one by one, and each once: a text is mostly the same words.
            wide = measured(word, font, bold)
            if line and long + blank + wide <= KERNING * room:
                line, long = f"{line} {word}", long + blank + wide
                continue
            lines += [line] if line else []
            while measured(word, font, bold) > KERNING * room and len(word) > 1:
                fits = _fitting(word, KERNING * room, font, bold)
                lines.append(word[:fits])
                word = word[fits:]
            line, long = word, measured(word, font, bold)
        lines.append(line)
    return tuple(lines)


def _fitting(word: str, room: float, font: str, bold: bool) -> int:
    """How many characters of a word have room, at least one."""
    low, high = 1, len(word)
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (
            (middle, high) if measured(word[:middle], font, bold) <= room else (low, middle - 1)
        )
    return low


def picture(image: np.ndarray, lights: np.ndarray | None = None, limit: float = 0.0) -> Any:
    """What draws an image (h, w) or (h, w, 3) of [0, 1] into its panel, or with a ``limit`` levels
    between it and its negative, with the ``lights`` (u, v) marked."""

    return functools.partial(_draw_picture, image, lights, limit)


def _draw_picture(image: np.ndarray, lights: np.ndarray | None, limit: float, axes: Any) -> Any:
    shown = axes.imshow(
        image if limit or image.ndim == 2 else np.clip(image, 0, 1),
        cmap=SIGNED if limit else "gray",
        vmin=-limit if limit else 0,
        vmax=limit or 1,
        extent=(0, 1, 0, 1),
        aspect="auto",
        interpolation="nearest",
    )
    for u, v in () if lights is None else lights:
        mark_light(axes, float(u), float(v))
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    return shown


def shares(
    image: np.ndarray, maps: Mapping[str, np.ndarray], colours: Mapping[str, str]
) -> Callable[[Any], Any]:
    """What draws ``maps`` (rows, columns) over the dimmed ``image``, each in its colour."""
    return functools.partial(_draw_shares, image, dict(maps), colours)


def _draw_shares(
    image: np.ndarray, maps: Mapping[str, np.ndarray], colours: Mapping[str, str], axes: Any
) -> Any:
    from matplotlib.colors import to_rgb

    grey = image if image.ndim == 2 else image.mean(-1)
    whole = {"extent": (0, 1, 0, 1), "aspect": "auto"}
    axes.imshow(np.clip(grey, 0, 1) * DIMMED, cmap="gray", vmin=0, vmax=1, **whole)
    # The square root makes the faint parts visible.
    strength = {n: np.sqrt(share / max(share.max(), 1e-30)) for n, share in maps.items()}
    colour = sum(s[..., None] * np.array(to_rgb(colours[n])) for n, s in strength.items())
    alpha = np.max(list(strength.values()), 0)
    layer = np.clip(np.concatenate([np.asarray(colour), alpha[..., None]], -1), 0, 1)
    return axes.imshow(layer, interpolation="bilinear", **whole)


def mark_light(axes: Any, u: float, v: float) -> None:
    """A ring at the light, or an arrow at the frame towards a light outside."""
    if 0 <= u <= 1 and 0 <= v <= 1:
        axes.plot(u, v, "o", ms=11, mfc="none", mec="black", mew=2.5)
        axes.plot(u, v, "o", ms=11, mfc="none", mec="gold", mew=1.3)
        return
    away = np.array([u, v]) - 0.5
    edge = 0.5 + away * (0.47 / np.abs(away).max())
    tail = edge - 0.12 * away / np.hypot(*away)
    axes.annotate(
        "",
        xy=tuple(edge),
        xytext=tuple(tail),
        arrowprops={"arrowstyle": "-|>", "color": "gold", "lw": 2.5, "ec": "black"},
    )
