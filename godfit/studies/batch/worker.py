"""One fit of a batch, in whichever process it runs: options with names of files in, a record out.

A worker process has one core, and XLA makes as many threads as the process has cores when JAX is
imported. So nothing here imports JAX at the top.
"""

from __future__ import annotations

import functools
import gc
import hashlib
import io
import json
import os
import platform
import time
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

THUMBNAIL_HEIGHT = 32
"""Rows of a thumbnail: a line of the report's table."""
THUMBNAIL_WIDTH = 64
"""Most columns of a thumbnail."""
WORKER_BYTES = 900 << 20
"""Memory of a worker, in bytes, from which its compiled programs are released: pictures of many
sizes each leave some."""
GARBAGE_THRESHOLD = 100_000
"""Objects that are allocated between two garbage collections, as in a command."""
CONVERGED, NOT_CONVERGED, FAILED, CRASHED = "converged", "not converged", "failed", "crashed"
STATUSES = (CONVERGED, NOT_CONVERGED, FAILED, CRASHED)
"""How a fit ends. A failed one raised an error; a crashed one ended its process."""


class Outcome(NamedTuple):
    """How a fit ended: one of STATUSES, the contents of fit.json (None where it failed), the error,
    the seconds it took, the host, and a small WebP of the target (empty where there is none)."""

    status: str
    record: dict[str, Any] | None = None
    error: str = ""
    seconds: float = 0.0
    host: str = ""
    thumbnail: bytes = b""


class Task(NamedTuple):
    """What a worker is sent: plain values, with names of files relative to the folder ``root``.

    ``folder`` is where the pictures of the result go, empty for none, with its ``page`` if wanted.
    ``version`` is that of the package which sends it. ``own_process`` says that the
    process may be set up for fits alone.
    """

    targets: tuple[str, ...]
    options: Mapping[str, Any]
    root: str
    folder: str = ""
    command: str = ""
    version: str = ""
    own_process: bool = True
    page: bool = False


def fit_one(task: Task) -> Outcome:
    """Fit one picture or clip. What goes wrong is the outcome's error; nothing is raised but an
    interrupt."""
    from godfit.errors import InputError, plain

    began = time.perf_counter()
    record, thumbnail, error = None, b"", ""
    try:
        _check_version(task.version)
        if task.own_process:
            _set_up_process()
        record, thumbnail = _fitted(task)
    except (InputError, MemoryError) as raised:
        error = str(raised) or "out of memory"
    except OSError as raised:
        error = f"{raised.filename or 'file'}: {raised.strerror or raised}"
    except Exception as raised:
        # One frame must not end the others.
        error = f"unexpected {type(raised).__name__}: {raised}"
    if task.own_process:
        _bound_memory()
    seconds, host = time.perf_counter() - began, platform.node()
    error = plain(error).replace(os.path.join(task.root, ""), "")
    if record is None:
        return Outcome(FAILED, None, error, seconds, host, thumbnail)
    status = CONVERGED if record["converged"] else NOT_CONVERGED
    # Text and back: the journal, and a result that has travelled, hold the same.
    return Outcome(status, json.loads(json.dumps(record)), error, seconds, host, thumbnail)


def _check_version(version: str) -> None:
    from importlib import metadata

    from godfit.errors import InputError

    own = metadata.version("godfit")
    if version not in ("", own):
        raise InputError(
            f"worker on {platform.node()}: expected godfit {version}, as the client has it, got "
            f"{own}; install one version on all machines"
        )


@functools.cache
def _set_up_process() -> None:
    """Caches, memory and garbage collection, as in a command."""
    from godfit.runtime.malloc import return_freed_memory

    # Before JAX's first block of memory.
    return_freed_memory()
    from godfit.runtime.cache import enable_jax_cache
    from godfit.runtime.program_cache import enable_program_cache

    enable_jax_cache()
    enable_program_cache()
    gc.set_threshold(GARBAGE_THRESHOLD)


def _bound_memory() -> None:
    """Release compiled programs where a worker holds much memory."""
    from godfit.runtime.memory import resident_memory

    if (resident_memory() or 0) < WORKER_BYTES:
        return
    import jax

    from godfit.runtime.program_cache import disable_program_cache, enable_program_cache

    disable_program_cache()
    jax.clear_caches()
    gc.collect()
    enable_program_cache()


def _fitted(task: Task) -> tuple[dict[str, Any], bytes]:
    """The record of a fit and its thumbnail; raises what the fit raises."""
    from godfit.errors import InputError
    from godfit.io.frames import is_video

    options = _located(task.options, task.root)
    targets = [_absolute(target, task.root) for target in task.targets]
    every, seed = options.pop("every", 1), options.pop("seed", 0)
    with warnings.catch_warnings():
        # What is worth a warning is among the warnings of the record.
        warnings.simplefilter("ignore")
        if len(targets) > 1 or is_video(targets[0]):
            result, shown = _clip(targets, every, seed, options)
        else:
            result, shown = _picture(targets[0], seed, options)
        record = result.record(task.command)
        given = {name: _plain(value) for name, value in task.options.items()}
        record["options"] = {"targets": list(task.targets), **given}
        record["inputs"] = _relative(record.get("inputs", {}), task.root)
        for frame in record.get("frames", ()):
            frame["path"] = frame["path"].removeprefix(os.path.join(task.root, ""))
        if task.folder:
            try:
                result.save(task.folder, task.command, task.page)
                _save_record(Path(task.folder), record)
            except OSError as error:
                raise InputError(f"'{task.folder}': {error.strerror or error}") from error
    return record, _thumbnail(shown)


def _picture(target: str, seed: int, options: dict[str, Any]) -> tuple[Any, Any]:
    """The fit of one picture, and the picture (h, w, ...) as it is shown."""
    from godfit.fitting import fit
    from godfit.io.ignored import valid_pixels
    from godfit.io.image import read_image
    from godfit.io.regular_files import read_regular
    from godfit.io.sources import without_holes
    from godfit.runtime.memory import FIT_BYTES, check_memory

    ignore, scene = options.pop("ignore", ()), options.get("scene")
    image = read_image(target, transfer=options.get("transfer", "none"), finite=False)
    height, width = image.values.shape[:2]
    check_memory(FIT_BYTES * height * width, f"target: {width}x{height} pixels")
    valid = valid_pixels(ignore, (height, width))
    image = without_holes(image, valid)
    result = fit(image, valid=valid, seed=seed, **options)
    if scene is not None:
        digest = hashlib.sha256(read_regular(scene, "a scene")).hexdigest()
        result.inputs["scene"] = {"path": scene, "sha256": digest}
    return result, image.encoded


def _clip(targets: list[str], every: int, seed: int, options: dict[str, Any]) -> tuple[Any, Any]:
    """The fit of a clip, and its first frame (h, w, 3) as it is shown."""
    from godfit.io.frames import frames, is_video
    from godfit.io.ignored import valid_pixels
    from godfit.io.sidecar import OF_EACH_FRAME, read_sidecar, sources_of
    from godfit.studies.clip import Shot, fit_clip

    sidecars = {target: read_sidecar(target) for target in targets if not is_video(target)}
    files = {name: options.pop(name) for name in OF_EACH_FRAME if name in options}
    ignore, valid = options.pop("ignore", ()), None
    if ignore:
        valid = valid_pixels(ignore, next(iter(frames(targets, every))).values.shape[:2])
    images = frames(targets, every, options.pop("transfer", "none"))
    shots = (
        Shot(image, **sources_of(image.path, number, sidecars.get(image.path, {}), files))
        for number, image in enumerate(images, 1)
    )
    result = fit_clip(shots, valid=valid, seed=seed, **options)
    return result, result.shown


def _absolute(path: str, root: str) -> str:
    """A name relative to ``root``; as it is where that is the working folder."""
    return path if os.path.isabs(path) or os.getcwd() == root else os.path.join(root, path)


def _located(options: Mapping[str, Any], root: str) -> dict[str, Any]:
    from godfit.studies.batch.jobs import FILES

    found = {name: _plain(value) for name, value in options.items()}
    found |= {name: _absolute(found[name], root) for name in FILES if name in found}
    if "ignore" in found:
        # A rectangle is no file.
        places = [(text, _absolute(text, root)) for text in found["ignore"]]
        found["ignore"] = [place if os.path.isfile(place) else text for text, place in places]
    return found


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _relative(inputs: Mapping[str, Any], root: str) -> dict[str, Any]:
    """The inputs of a record, with the names that the client has for them."""
    prefix = os.path.join(root, "")
    return {
        role: entry | {"path": entry["path"].removeprefix(prefix)} if "path" in entry else entry
        for role, entry in inputs.items()
    }


def _save_record(folder: Path, record: Mapping[str, Any]) -> None:
    from godfit.runtime.files import atomic_write

    text = json.dumps(record, indent=1, ensure_ascii=False) + "\n"
    atomic_write(folder / "fit.json", text.encode(errors="backslashreplace"))


def _thumbnail(values: Any) -> bytes:
    """A WebP of at most THUMBNAIL_HEIGHT rows of an image (h, w), (h, w, 1) or (h, w, 3), encoded,
    1 the brightest; empty where it cannot be made."""
    import numpy as np
    from PIL import Image

    array = np.nan_to_num(np.atleast_3d(np.asarray(values, np.float32))).clip(0, 1)
    pixels = np.broadcast_to(array, (*array.shape[:2], 3)) if array.shape[2] == 1 else array
    image = Image.fromarray((pixels * 255 + 0.5).astype(np.uint8))
    image.thumbnail((THUMBNAIL_WIDTH, THUMBNAIL_HEIGHT))
    out = io.BytesIO()
    try:
        image.save(out, "WEBP", quality=60)
    except (OSError, KeyError):
        # A Pillow without WebP.
        return b""
    return out.getvalue()
