"""The command line: ``python -m godfit`` or ``godfit``."""

from __future__ import annotations

import sys

if __name__ == "__main__" and not sys.flags.safe_path:
    # ``python -m`` puts the current folder on the path, where a file beside the pictures may have
    # the name of a module. An empty entry of PYTHONPATH means that folder too.
    import os

    try:
        here = os.getcwd()
    except OSError:
        # The folder was removed.
        here = ""
    sys.path[:] = [place for place in sys.path[1:] if place not in ("", os.curdir, here)]

import os

from godfit.runtime.interrupts import INTERRUPTED, end_on_interrupt, interrupt_message

if __name__ == "__main__" or os.path.basename(sys.argv[0]) in ("godfit", "godfit.exe"):
    end_on_interrupt()

import difflib
import gc
import re
import traceback
import warnings
from typing import Any

import click

from godfit.commands.batch import batch
from godfit.commands.compare import compare
from godfit.commands.export import export
from godfit.commands.fit import fit
from godfit.commands.mask import mask
from godfit.commands.render import render
from godfit.commands.rerun import rerun
from godfit.commands.select import select
from godfit.commands.shaders import shaders
from godfit.commands.simplify import simplify
from godfit.commands.streams import close_streams, open_streams
from godfit.commands.view import view
from godfit.errors import InputError, plain
from godfit.runtime.files import forget_written, written_files
from godfit.runtime.memory import available_memory

OUT_OF_MEMORY = re.compile("RESOURCE_EXHAUSTED|bad_alloc|[Oo]ut of memory")
"""In the text of an error of XLA: there was no memory."""
GARBAGE_THRESHOLD = 100_000
"""Objects that are allocated between two garbage collections; imports and tracing make many objects
and little garbage, and a collection takes some hundredths of a command."""


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="godfit")
def cli() -> None:
    """Estimate the parameters of god rays from images."""


for command in (fit, batch, compare, select, simplify, render, rerun, export, mask, view, shaders):
    cli.add_command(command)


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit status: 0 done, 1 bad input, 2 bad usage, 3 not converged,
    130 interrupted. Errors are one line on stderr."""
    forget_written()
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
        message, status = interrupt_message(), INTERRUPTED
    except InputError as error:
        message, status = str(error), 1
    except (MemoryError, RuntimeError) as error:
        # XLA raises errors of its own, which are RuntimeErrors.
        if not isinstance(error, MemoryError) and not OUT_OF_MEMORY.search(str(error)):
            raise
        has = available_memory()
        room = "" if has is None else f", has {has / 2**30:.2g} GiB"
        need = re.search(r"[\d.]+ ?([KMGT]i?B|bytes)", str(error))
        message = f"out of memory: needs {f'another {need[0]}' if need else 'more'}{room}; "
        message, status = message + f"give a smaller target; {written_files()}", 1
    except OSError as error:
        where = f"'{error.filename}': " if error.filename else ""
        message, status = f"{where}{error.strerror or error}; {written_files()}", 1
    print(f"godfit: error: {' '.join(plain(message).split())}", file=sys.stderr)
    return status


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    if not {"-q", "--quiet"} & {*sys.argv}:
        print(f"godfit: warning: {' '.join(plain(str(message)).split())}", file=sys.stderr)


def run() -> None:
    """The ``godfit`` command."""
    end_on_interrupt()
    # A fit is a sequence of many small programs, for which a GPU takes longer than a CPU, and some
    # of them are compiled for CPUs alone. JAX reads this variable when it is first imported.
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    for variable in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        # As their rule says. matplotlib would make its folders in the current one.
        if variable in os.environ and not os.path.isabs(os.environ[variable]):
            del os.environ[variable]
    # Figures have a canvas of their own. A backend that is not installed would fail their import.
    os.environ["MPLBACKEND"] = "agg"
    open_streams()
    warnings.showwarning = _show_warning
    gc.set_threshold(GARBAGE_THRESHOLD)
    try:
        status = close_streams(main())
    except BaseException as error:
        # An exception that left here would end the interpreter while threads run compiled code.
        status = 1
        if {"-v", "--verbose"} & {*sys.argv}:
            traceback.print_exc()
        what = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        print(
            f"godfit: error: unexpected {' '.join(plain(what).split())}; {written_files()}; "
            "please report it, with the lines that -v adds",
            file=sys.stderr,
            flush=True,
        )
    # An ordinary exit takes a third of a second, and would free the memory of compiled programs
    # that an interrupt has left running.
    os._exit(status)


if __name__ == "__main__":
    run()
