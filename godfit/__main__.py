"""The command line: ``python -m godfit`` or ``godfit``."""

from __future__ import annotations

import difflib
import gc
import os
import signal
import sys
from typing import Any

import click

from godfit.commands.compare import compare
from godfit.commands.fit import fit
from godfit.commands.mask import mask
from godfit.commands.progress import Progress
from godfit.commands.render import render
from godfit.commands.select import select
from godfit.commands.shaders import shaders
from godfit.commands.simplify import simplify
from godfit.commands.streams import close_streams, open_streams
from godfit.errors import InputError

INTERRUPTED = 130
"""Exit status after an interrupt: 128 plus the number of SIGINT, as shells have it."""
GARBAGE_THRESHOLD = 100_000
"""Objects that are allocated between two garbage collections; imports and tracing make many objects
and little garbage, and a collection takes some hundredths of a command."""


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="godfit")
def cli() -> None:
    """Estimate the parameters of god rays from images."""


for command in (fit, compare, select, simplify, render, mask, shaders):
    cli.add_command(command)


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit status: 0 done, 1 bad input, 2 bad usage, 3 not converged,
    130 interrupted. Errors are one line on stderr."""
    try:
        return cli.main(arguments, prog_name="godfit", standalone_mode=False) or 0
    except click.UsageError as error:
        message, status = error.format_message(), 2
        if isinstance(error, click.NoSuchOption) and error.possibilities:
            closest = difflib.get_close_matches(error.option_name, error.possibilities, 1)
            message = f"{error.option_name}: no such option; did you mean {(closest or ['-h'])[0]}?"
    except click.ClickException as error:
        message, status = error.format_message(), 1
    except (click.Abort, KeyboardInterrupt):
        message, status = "interrupted; nothing was written", INTERRUPTED
    except InputError as error:
        message, status = str(error), 1
    except MemoryError:
        message, status = "out of memory; give a smaller target or free some", 1
    except OSError as error:
        where = f"'{error.filename}': " if error.filename else ""
        message, status = f"{where}{error.strerror or error}; nothing was written", 1
    print(f"godfit: error: {' '.join(message.split())}", file=sys.stderr)
    return status


def _interrupt(number: int, frame: Any) -> None:
    Progress.interrupted = True
    signal.default_int_handler(number, frame)


def run() -> None:
    """The ``godfit`` command."""
    # A fit is a sequence of many small programs, for which a GPU takes longer than a CPU, and some
    # of them are compiled for CPUs alone. JAX reads this variable when it is first imported.
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    # Figures have a canvas of their own. A backend that is not installed would fail their import.
    os.environ["MPLBACKEND"] = "agg"
    open_streams()
    signal.signal(signal.SIGINT, _interrupt)
    # Python prints an interrupt that falls into a finaliser and goes on; the next stage stops then.
    sys.unraisablehook = lambda unraisable: (
        None
        if isinstance(unraisable.exc_value, KeyboardInterrupt)
        else sys.__unraisablehook__(unraisable)
    )
    gc.set_threshold(GARBAGE_THRESHOLD)
    status = close_streams(main())
    # An ordinary exit takes a third of a second, and would free the memory of compiled programs
    # that an interrupt has left running.
    os._exit(status)


if __name__ == "__main__":
    run()
