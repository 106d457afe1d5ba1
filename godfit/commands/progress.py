"""Progress and warnings of a command, on stderr."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from typing import Any

import click

from godfit.errors import plain

SPINNER_DELAY = 1.0
"""Seconds after which a spinner is shown: shorter work needs none."""

QUIET_SECONDS = 2.0
"""Seconds after which a line is printed where stderr is no terminal."""


LOADING = "loading JAX"
"""The first stage of every command."""


class Progress:
    """Stages of the work on stderr. On a terminal they are a spinner, once a second has passed,
    unless ``quiet``. With ``verbose`` each is a line, wherever stderr goes. Elsewhere a line now
    and then says what long work is doing."""

    def __init__(self, quiet: bool, verbose: bool) -> None:
        self.spins = not quiet and not verbose and sys.stderr.isatty()
        self.verbose = verbose and not quiet
        self.plain = not quiet and not verbose and not self.spins
        self.began = time.perf_counter()
        self.stage, self.ended = "", threading.Event()
        self.status: Any = None

    def __call__(self, stage: str) -> None:
        elapsed = time.perf_counter() - self.began
        self.stage = stage
        if self.verbose:
            click.echo(f"godfit: {elapsed:6.2f} s  {stage}", err=True)
        elif self.spins and self.status is not None:
            self.status.update(stage)
        elif self.spins and elapsed > SPINNER_DELAY:
            from rich.console import Console

            self.status = Console(stderr=True).status(stage)
            self.status.start()

    def _speak(self) -> None:
        """Print the stage whenever it is another one after QUIET_SECONDS."""
        said = ""
        while not self.ended.wait(QUIET_SECONDS):
            # What is wrong with the input is found by then: it is one line without others.
            if self.stage not in (said, LOADING):
                said = self.stage
                # A pipe that is closed ends no fit.
                with contextlib.suppress(OSError, ValueError):
                    click.echo(f"godfit: {said}", err=True)

    def __enter__(self) -> Progress:
        if self.plain:
            threading.Thread(target=self._speak, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.ended.set()
        if self.status is not None:
            self.status.stop()


def warn(text: str) -> None:
    """Print a warning, one line."""
    click.echo(f"godfit: warning: {plain(text)}", err=True)
