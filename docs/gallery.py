"""The gallery: targets of data_synthetic/ are fitted when the docs are built."""

import os
from pathlib import Path

DATA = Path(__file__).parents[1] / "data_synthetic"
ENTRIES = ("disc", "coloured", "background", "offscreen")
"""Targets with a mask, each of which shows something else."""


def fit_all(folder: Path) -> None:
    """Write fit.png, and report.html where this version makes one, for every entry.

    ``GODFIT_GALLERY=off`` leaves out what is there already, and what is not: pages are then quick
    to build, and the gallery has no pictures.
    """
    folder.mkdir(exist_ok=True)
    lines = []
    for name in ENTRIES:
        if os.environ.get("GODFIT_GALLERY") != "off":
            _fit(name, folder / name)
        lines += _entry(name, folder / name)
    (folder / "entries.txt").write_text("\n".join(lines), encoding="utf-8")


def _fit(name: str, into: Path) -> None:
    # As the command has it, with its cache of compiled programs.
    from godfit.__main__ import main

    status = main(["fit", str(DATA / f"{name}.png"), "-q", "-o", str(into)])
    if status != 0:
        raise RuntimeError(f"gallery: expected '{name}' to converge, got exit status {status}")


def _entry(name: str, folder: Path) -> list[str]:
    lines = [f"## {name}", "", f"    python -m godfit fit data_synthetic/{name}.png", ""]
    if (folder / "fit.png").is_file():
        lines += [f"![Target, fitted image, residual and parameters]({name}/fit.png)", ""]
    if (folder / "report.html").is_file():
        lines += [f"{{download}}`The live report <{name}/report.html>`", ""]
    return lines
