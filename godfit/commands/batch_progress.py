"""Progress of a batch on stderr: done, failed, fits a minute, time left."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from godfit.studies.batch.run import FrameFit

LINE_SECONDS = 30.0
"""Time between two lines where stderr is no terminal, in seconds."""
RATE_SECONDS = 60.0
"""Time over which fits a minute are counted, in seconds: the first ones compile."""


class BatchProgress:
    """Counts of ``total`` frames, ``left`` of which are to be fitted: one line that changes on a
    terminal, elsewhere a line each LINE_SECONDS, nothing if ``quiet``."""

    def __init__(self, total: int, left: int, quiet: bool) -> None:
        from rich.console import Console

        self.total, self.left, self.fitted, self.failed = total, left, total - left, 0
        self.console, self.quiet = Console(stderr=True), quiet
        self.ends: list[float] = []
        self.ended = threading.Event()
        self.status: Any = None

    def __enter__(self) -> BatchProgress:
        if not self.quiet and self.left:
            if self.console.is_terminal:
                self.status = self.console.status(self.line())
                self.status.start()
            else:
                threading.Thread(target=self._speak, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.ended.set()
        if self.status is not None:
            self.status.stop()

    def add(self, frame: FrameFit) -> None:
        """A fit has ended."""
        self.fitted, self.failed = self.fitted + 1, self.failed + (frame.record is None)
        now = time.monotonic()
        self.ends.append(now)
        while self.ends[0] < now - RATE_SECONDS:
            self.ends.pop(0)
        if self.status is not None:
            self.status.update(self.line())

    def line(self) -> str:
        """What is shown now."""
        text = f"{self.fitted} of {self.total} frames"
        if self.failed:
            text += f", {self.failed} failed"
        if len(self.ends) > 1 and self.ends[-1] > self.ends[0]:
            rate = (len(self.ends) - 1) / (self.ends[-1] - self.ends[0])
            left = max(0.0, (self.total - self.fitted) / rate)
            text += f", {60 * rate:.3g} a minute, {_clock(left)} left"
        return text

    def _speak(self) -> None:
        while not self.ended.wait(LINE_SECONDS):
            # A pipe that is closed ends no run.
            with contextlib.suppress(OSError, ValueError):
                click.echo(f"godfit: {self.line()}", err=True)


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"
