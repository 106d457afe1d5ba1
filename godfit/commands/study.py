"""Steps that all fitting commands share: from a target's files to a folder of results."""

from __future__ import annotations

import json
import logging
import os
import re
import shlex
import sys
import threading
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import click

from godfit.commands.options import Run
from godfit.commands.progress import LOADING, Progress, warn
from godfit.errors import InputError
from godfit.io.ignored import valid_pixels

if TYPE_CHECKING:
    import numpy as np

    from godfit.io.image import Image

VIDEO_FRAME = re.compile(r"#\d+$")
"""The number of a frame, at the end of its name."""
SUM = "godfit_sums_single", "godfit.scattering.radial.strips_kernel:_sums_single"
"""Name and place of the compiled function that nearly every fit needs and waits for; the module
that declares it imports JAX."""
NOT_CONVERGED = 3
"""Exit status of a fit that did not converge."""
PROGRAM_SETTINGS = {
    "model", "shader", "samples", "lights", "pass_scale", "transfer", "bright_pass", "border",
    "tint",
}  # fmt: skip
"""Options that change which programs are compiled."""


class Study(NamedTuple):
    """A target, (h, w) which of its pixels are fitted, the options of its fit, and the result's
    folder."""

    image: Image
    valid: np.ndarray | None
    options: dict[str, Any]
    folder: Path


def folder_for(targets: Sequence[str], output: str | None) -> Path:
    """The folder of the result of one target, or of the frames of a clip. It is checked before the
    work: raises InputError if it cannot be written, and if a default folder holds the result of
    another target."""
    folder = Path(output) if output else Path(common_name(targets)).with_suffix(".godfit")
    other = None if output else other_target(folder, targets)
    if other is not None:
        raise InputError(
            f"output: '{folder}' already holds the result of '{other}'; choose another folder with "
            "-o, or remove it"
        )
    near = folder
    while not near.exists() and near != near.parent:
        near = near.parent
    if not near.is_dir():
        raise InputError(
            f"output: expected a folder, got the file '{near}'; choose another with -o"
        )
    if not os.access(near, os.W_OK):
        raise InputError(f"output: '{near}' cannot be written; choose another folder with -o")
    return folder


def common_name(targets: Sequence[str]) -> str:
    """The first frame's name without its number: frame_01.png, frame_02.png are ``frame``. A single
    target keeps its name."""
    if len(targets) == 1:
        return targets[0]
    stem = Path(targets[0]).stem.rstrip("0123456789_-. ")
    return str(Path(targets[0]).with_name(stem or "clip"))


def other_target(folder: Path, targets: Sequence[str]) -> str | None:
    """The target, or the first frame, whose result lies in a folder, if ``targets`` are others:
    frame.png and frame.jpg have one default folder."""
    for name in ("fit.json", "select.json", "compare.json"):
        try:
            record = json.loads((folder / name).read_bytes())
            fits = [record, record.get("fit"), *(row["fit"] for row in record.get("fits", ()))]
            earlier = [frame["path"] for frame in record.get("frames", ())]
            earlier += [fit["inputs"]["target"]["path"] for fit in fits if fit and "inputs" in fit]
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            # No record, or one that nobody here has written: it is replaced as before.
            continue
        # A frame of a video has its number after the video's name.
        mine, theirs = Path(targets[0]), Path(VIDEO_FRAME.sub("", earlier[0]) if earlier else "")
        numbered = len(targets) > 1 and "frames" in record
        same = mine.suffix == theirs.suffix if numbered else mine.name == theirs.name
        if not same and theirs.name:
            return str(theirs)
    return None


def opened(
    target: str, given: Mapping[str, Any], output: str | None, *, bare: bool = False
) -> Study:
    """The target with its options: those of the file beside it, overridden by ``given`` ones. With
    ``bare`` it needs neither a mask nor a scene."""
    from godfit.io.image import read_image
    from godfit.io.sidecar import options_beside
    from godfit.io.sources import without_holes

    options = options_beside(target, given)
    ignore = options.pop("ignore")
    folder = folder_for([target], output)
    # The target is read first: a missing one should not be reported as a missing mask.
    image = read_image(target, transfer=options.get("transfer", "none"), finite=False)
    if "mask" in options and "scene" in options:
        raise click.UsageError("expected --mask or --scene, got both; a scene draws its own mask")
    if "mask" not in options and "scene" not in options and not bare:
        raise click.UsageError(
            "expected --mask IMAGE or --scene SCENE.toml, or "
            f"{Path(target).with_suffix('.toml').name} beside the target naming one; got neither"
        )
    valid = valid_pixels(ignore, image.values.shape[:2])
    return Study(without_holes(image, valid), valid, options, folder)


def start_jax() -> None:
    """Import JAX. Raises InputError where there is too little memory for that, and where
    ``JAX_PLATFORMS`` names no device that JAX finds."""
    from godfit.runtime.malloc import return_freed_memory
    from godfit.runtime.memory import check_program_memory

    check_program_memory()
    return_freed_memory()
    import jax

    try:
        jax.devices()
    except RuntimeError as error:
        platforms = os.environ.get("JAX_PLATFORMS", "")
        raise InputError(
            f"JAX_PLATFORMS: expected names of devices, such as cpu, got '{platforms}': {error}"
        ) from error


@contextmanager
def working(run: Run) -> Iterator[Progress]:
    """Show progress, and keep compiled programs and little memory."""
    with Progress(run.quiet, run.verbose) as progress:
        progress(LOADING)
        from godfit.runtime.machine_code import compile_ahead

        compile_ahead(*SUM)
        from godfit.runtime.cache import enable_jax_cache
        from godfit.runtime.program_cache import enable_program_cache, save_preload_list

        start_jax()
        # matplotlib logs that it cannot store its list of fonts: a full disk costs time alone.
        logging.getLogger("matplotlib").setLevel(logging.ERROR)
        enable_jax_cache()
        enable_program_cache()
        try:
            yield progress
        finally:
            save_preload_list()


def prepare(
    options: dict[str, Any],
    run: Run,
    progress: Progress,
    size: tuple[int, ...] = (),
    draws: bool = True,
) -> None:
    """Replace the scene's file by the scene, and warn of defaults that are assumed. ``size`` is
    the target's: each size has programs of its own. ``draws`` is whether this process draws a
    figure. Raises InputError for a size whose fit needs more memory than there is."""
    from godfit.runtime.memory import FIT_BYTES, check_memory
    from godfit.runtime.program_cache import expect_programs

    if size:
        check_memory(FIT_BYTES * size[0] * size[1], f"target: {size[1]}x{size[0]} pixels")
    if isinstance(options.get("scene"), str):
        from godfit.scenes.scene import read_scene

        progress("loading meshes")
        options["scene"] = read_scene(options["scene"])
    if options.get("model", "mitchell") == "mitchell" and not run.quiet:
        warn_of_defaults(options)
    # In a thread: XLA holds the interpreter's lock only a little of the time.
    kernels = options.get("model", "mitchell") == "mitchell"
    settings = {name: options[name] for name in sorted(options) if name in PROGRAM_SETTINGS}
    run_key = repr((sys.argv[1:2], size, settings))
    expect_programs(run_key)
    threading.Thread(target=_load_ahead, args=(kernels, run_key, draws), daemon=True).start()


def warn_of_defaults(options: Mapping[str, Any]) -> None:
    """Warn of a shader or a number of samples that was not given."""
    from godfit.scattering.conventions import AUTO, convention

    settings = {**options["scene"].settings, **options} if "scene" in options else options
    if "shader" not in settings:
        warn("no shader given: 'mitchell' assumed; see `godfit shaders`")
    if settings.get("shader") == AUTO:
        return
    shader = convention(settings.get("shader", "mitchell"))
    if "samples" not in settings and "samples" not in shader.defaults:
        warn(f"{shader.name} publishes no default: {shader.samples} samples assumed")


def _load_ahead(kernels: bool, run_key: str, draws: bool) -> None:
    from godfit.runtime.program_cache import preload_programs

    if kernels:
        from godfit.scattering.radial.exact import compile_fastest

        compile_fastest()
    preload_programs(run_key)
    if draws:
        import matplotlib.backends.backend_agg
        import matplotlib.figure  # noqa: F401


def command_line() -> str:
    return shlex.join(["godfit", *sys.argv[1:]])


@runtime_checkable
class Result(Protocol):
    """The result of every study: a table, a record, and files."""

    def summary(self) -> str: ...
    def record(self, command: str = "") -> dict[str, Any]: ...


def save_result(result: SavedResult, run: Run, folder: Path, names: tuple[str, ...]) -> str:
    """Write a result's files ``names`` into ``folder``, the record first, and return a line that
    lists those that were written. Pictures that fail are warned of. Where the record cannot be
    written, the result is printed all the same before the OSError is raised."""
    from godfit.report.files import PAGE, PictureNotWritten

    names += (PAGE,) if run.html else ()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", PictureNotWritten)
        try:
            result.save(folder, command_line(), run.html)
        except OSError:
            print_result(result, (), run)
            raise
    failed = [w.message for w in caught if isinstance(w.message, PictureNotWritten)]
    for message in failed:
        if not run.quiet:
            warn(str(message))
    lost = {message.name for message in failed}
    return f"{folder}{os.sep}: {', '.join(name for name in names if name not in lost)}"


@runtime_checkable
class SavedResult(Result, Protocol):
    """A result that has a folder of its own."""

    def save(
        self, folder: str | os.PathLike[str], command: str = "", page: bool = True
    ) -> None: ...


def print_result(result: Result, notes: Iterable[str], run: Run, files: str = "") -> None:
    """Print warnings, and the record, or the summary with the ``files`` that were written. A
    sentence that the summary holds is printed there alone."""
    summary = "" if run.as_json else result.summary()
    if not run.quiet:
        for note in dict.fromkeys(notes):
            if note not in summary:
                warn(note)
    if run.as_json:
        click.echo(json.dumps(result.record(command_line()), indent=1, ensure_ascii=False))
    else:
        click.echo(summary)
        if files:
            click.echo(f"\n  {files}")
