"""What a batch fits: the pictures and clips that patterns name, each with its options and a key."""

from __future__ import annotations

import glob
import hashlib
import io
import json
import os
import re
import tomllib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from godfit.errors import InputError
from godfit.io.frames import is_video
from godfit.io.regular_files import MAX_BINARY_BYTES, read_regular
from godfit.io.sidecar import (
    CLIP_OPTIONS,
    OF_EACH_FRAME,
    keep_one_source,
    named_after,
    options_beside,
    read_sidecar,
    shared_settings,
    sources_of,
)

KEY_VERSION = 1
"""Part of every key: it grows when equal inputs and options no longer mean an equal fit."""
FILES = ("mask", "scene", "canvas", "background", "occluder")
"""Options that name a file, by a pattern for all frames."""
HEADERS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "PPM")
"""Formats whose size Pillow finds in the first bytes."""
SCENE_FILES = (".toml", ".gltf")
"""Suffixes of files that name further files, which belong to what is fitted."""


class Job(NamedTuple):
    """One fit: a picture, or the frames of a clip.

    ``path`` names it in the table. ``targets`` is its picture, its video or its frames. ``options``
    are those of ``godfit.fit``, with names of files in place of images. Jobs of equal ``key`` have
    equal inputs and options. Jobs of one ``group`` need the same programs. ``pixels`` is the size
    of the picture, 0 where it is not known. ``error`` is a reason why nothing can be fitted.
    """

    path: str
    targets: tuple[str, ...]
    options: dict[str, Any]
    key: str
    group: str = ""
    pixels: int = 0
    error: str = ""


def job_for(targets: Sequence[str], given: Mapping[str, Any]) -> Job:
    """The job of one picture, or of the frames of one clip, as ``jobs_of`` has it."""
    return _job(_plan(tuple(targets), _without_defaults(given)), _Digests())


def _without_defaults(given: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: value
        for name, value in given.items()
        if value is not None and value is not False and value not in ((), [], {})
    }


class _Plan(NamedTuple):
    """Targets of a job with their options, the names of the files that serve them, and what is
    wrong with them."""

    targets: tuple[str, ...]
    options: dict[str, Any]
    files: list[str]
    error: str = ""

    @property
    def path(self) -> str:
        return self.targets[0] if len(self.targets) == 1 else os.path.dirname(self.targets[0])


def jobs_of(
    patterns: Sequence[str],
    given: Mapping[str, Any],
    clips: bool = False,
    shard: tuple[int, int] | None = None,
) -> list[Job]:
    """A job for every file that the ``patterns`` name, in natural order, or with ``clips`` for
    every folder of them. With ``shard`` (I, N) only every N-th job is made, from the I-th on.

    ``given`` options override those of the file beside a target. In names of files {stem} and
    {folder} are those of the target. Files that serve another target, as its mask for example, are
    no targets where a pattern matches them. Raises InputError for a pattern without a file.
    """
    given = _without_defaults(given)
    if "canvas" in given and ("mask" in given or "scene" in given):
        raise InputError("batch: expected a mask, a scene or a canvas, got two; give one")
    if "mask" in given and "scene" in given:
        raise InputError("batch: expected a mask or a scene, got both; a scene draws its own mask")
    named, matched = _expanded(patterns)
    paths = sorted({*named, *matched}, key=natural_order)
    plans = [_plan(ts, given) for ts in (_clips(paths) if clips else [(path,) for path in paths])]
    serving = {os.path.normpath(file) for plan in plans for file in plan.files}
    plans = [
        plan
        for plan in plans
        if not named.isdisjoint(plan.targets) or os.path.normpath(plan.targets[0]) not in serving
    ]
    number, count = shard or (1, 1)
    digests = _Digests()
    return [_job(plan, digests) for plan in plans[number - 1 :: count]]


def natural_order(path: str) -> list[Any]:
    """A key by which frame_2 comes before frame_10."""
    return [
        (int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path)
    ]


def _expanded(patterns: Sequence[str]) -> tuple[set[str], set[str]]:
    """(files named as they are, files that patterns match)."""
    named: set[str] = set()
    matched: set[str] = set()
    for pattern in patterns:
        if os.path.isdir(pattern):
            raise InputError(f"'{pattern}': expected files, got a folder; give '{pattern}/*.png'")
        if os.path.lexists(pattern) or not glob.has_magic(pattern):
            if not os.path.exists(pattern):
                raise InputError(f"'{pattern}': expected an image or a video, got no such file")
            named.add(pattern)
            continue
        found = {path for path in glob.glob(pattern, recursive=True) if os.path.isfile(path)}
        # A side file beside a picture is no picture.
        found = {path for path in found if not path.endswith((".toml", ".json"))}
        if not found:
            raise InputError(f"'{pattern}': expected files of this pattern, got none; change it")
        matched |= found
    return named, matched


def _clips(paths: Iterable[str]) -> list[tuple[str, ...]]:
    """The paths by folder, in order; a video is a clip by itself."""
    folders: dict[str, list[str]] = {}
    for path in paths:
        folders.setdefault(path if is_video(path) else os.path.dirname(path), []).append(path)
    return [tuple(frames) for frames in folders.values()]


def _plan(targets: tuple[str, ...], given: Mapping[str, Any]) -> _Plan:
    first = targets[0]
    try:
        if len(targets) > 1 or is_video(first):
            return _Plan(targets, *_clip_options(targets, given))
        options = _options(first, given)
    except InputError as error:
        return _Plan(targets, dict(given), [], str(error))
    return _Plan(targets, options, [options[name] for name in FILES if name in options])


def _job(plan: _Plan, digests: _Digests) -> Job:
    """The job of a plan. What is wrong with its files is the job's error."""
    targets, options, files, error = plan
    try:
        if error:
            raise InputError(error)
        found = [digests.picture(target) for target in targets]
        # A rectangle to ignore is no file.
        images = [text for text in options.get("ignore", ()) if os.path.isfile(text)]
        contents = [digest for digest, _, _ in found]
        contents += [digests.content(file) for file in (*files, *images)]
    except InputError as wrong:
        key = _key([plan.path, str(wrong)], options)
        return Job(plan.path, targets, options, key, error=str(wrong))
    settings = {name: value for name, value in options.items() if name not in FILES}
    settings["files"] = sorted(name for name in options if name in FILES)
    _, pixels, form = found[0]
    group = f"{form} {json.dumps(settings, sort_keys=True, default=str)}"
    return Job(plan.path, targets, options, _key(contents, settings), group, pixels)


def _key(contents: Sequence[str], settings: Mapping[str, Any]) -> str:
    """The SHA-256 of the contents' digests and the settings, 64 hexadecimal digits."""
    text = json.dumps([KEY_VERSION, contents, settings], sort_keys=True, default=str)
    return hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest()


def _options(path: str, given: Mapping[str, Any]) -> dict[str, Any]:
    patterns = {name: given[name] for name in FILES if name in given}
    given = {**given, **named_after(path, 1, patterns)}
    options = options_beside(path, given)
    keep_one_source(options, given)
    options.pop("every", None)
    if "mask" in options and "scene" in options:
        raise InputError(f"'{path}': expected a mask or a scene beside it, got both; give one")
    return options


def _clip_options(
    targets: Sequence[str], given: Mapping[str, Any]
) -> tuple[dict[str, Any], list[str]]:
    """The options of a clip, and the files of its frames. Raises InputError for an option that
    clips do not have."""
    for name in given:
        if name not in (*CLIP_OPTIONS, "every", "seed"):
            option = name.replace("_", "-")
            raise InputError(f"--{option}: expected pictures with it, got a clip; leave it out")
    stills = [target for target in targets if not is_video(target)]
    sidecars = {target: read_sidecar(target) for target in stills}
    options = shared_settings(sidecars) | dict(given)
    patterns = {name: given[name] for name in OF_EACH_FRAME if name in given}
    files = []
    for number, target in enumerate(targets, 1):
        if target in sidecars:
            files += sources_of(target, number, sidecars[target], patterns).values()
        else:
            # How many frames a video has is not known before it is decoded.
            every = {name: text.replace("{number}", "*") for name, text in patterns.items()}
            for text in named_after(target, 1, every).values():
                files += sorted(glob.glob(text))
    return options, files


class _Digests:
    """SHA-256 of files, each read once."""

    def __init__(self) -> None:
        self.known: dict[str, str] = {}

    def picture(self, path: str) -> tuple[str, int, str]:
        """The digest of a picture or a video, its pixels (0 if not known), and a text that is the
        same for pictures of equal size and kind."""
        data = read_regular(path, "an image or a video", MAX_BINARY_BYTES)
        digest = hashlib.sha256(data).hexdigest()
        size, mode = _header(data)
        return digest, size[0] * size[1], f"{Path(path).suffix} {size[0]}x{size[1]} {mode}"

    def content(self, path: str) -> str:
        """The digest of a file, with those of the files that a scene or a canvas names."""
        if path not in self.known:
            data = read_regular(path, "an image or a scene", MAX_BINARY_BYTES)
            # Before the files that it names: one of them may name this one again.
            self.known[path] = hashlib.sha256(data).hexdigest()
            named = [self.content(other) for other in _named_in(path, data)]
            if named:
                whole = "".join([self.known[path], *named])
                self.known[path] = hashlib.sha256(whole.encode()).hexdigest()
        return self.known[path]


def _header(data: bytes) -> tuple[tuple[int, int], str]:
    """(width, height) and mode of an image; (0, 0) where its header is of another format."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=HEADERS) as image:
                return image.size, image.mode
    except Exception:
        # The reader of the fit reports what is wrong with the file.
        return (0, 0), ""


def _named_in(path: str, data: bytes) -> list[str]:
    """The files that a scene or a canvas names, in order."""
    suffix = Path(path).suffix.lower()
    if suffix not in SCENE_FILES:
        return []
    try:
        text = data.decode("utf-8-sig")
        tree = tomllib.loads(text) if suffix == ".toml" else json.loads(text)
    except (ValueError, RecursionError):
        # The reader of the fit reports it.
        return []
    folder = os.path.dirname(path)
    found = [os.path.join(folder, text) for text in _texts(tree) if text and "\0" not in text]
    return sorted({file for file in found if os.path.isfile(file)})


def _texts(tree: Any) -> list[str]:
    """Every text in nested tables and lists."""
    if isinstance(tree, str):
        return [tree]
    below = tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else ()
    return [text for branch in below for text in _texts(branch)]
