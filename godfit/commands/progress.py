"""Progress and warnings of a command, on stderr."""

from __future__ import annotations

import time
from typing import Any

import click

from godfit.errors import plain

SPINNER_DELAY = 1.0
"""Seconds after which a spinner is shown: shorter work needs none."""


class Progress:
    """Stages of the work on stderr. On a terminal they are a spinner, once a second has passed,
    unless ``quiet``. With ``verbose`` each is a line, wherever stderr goes."""

    def __init__(self, quiet: bool, verbose: bool) -> None:
        from rich.console import Console

        self.console = Console(stderr=True)
        self.spins = not quiet and not verbose and self.console.is_terminal
        self.verbose = verbose and not quiet
        self.began = time.perf_counter()
        self.status: Any = None

    def __call__(self, stage: str) -> None:
        elapsed = time.perf_counter() - self.began
        if self.verbose:
            click.echo(f"godfit: {elapsed:6.2f} s  {stage}", err=True)
        elif self.spins and self.status is not None:
            self.status.update(stage)
        elif self.spins and elapsed > SPINNER_DELAY:
            self.status = self.console.status(stage)
            self.status.start()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self.status is not None:
            self.status.stop()


def warn(text: str) -> None:
    """Print a warning, one line."""
    click.echo(f"godfit: warning: {plain(text)}", err=True)
