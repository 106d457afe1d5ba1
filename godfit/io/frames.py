"""The frames of a clip, one at a time: image files in order, or the frames of a video."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from godfit.errors import InputError
from godfit.io.image import LEVELS, Image, check_pixels, decode, read_image

CONTAINERS = (
    (slice(4, 8), b"ftyp", "mov"),
    (slice(4, 8), b"moov", "mov"),
    (slice(4, 8), b"mdat", "mov"),
    (slice(4, 8), b"wide", "mov"),
    (slice(4, 8), b"free", "mov"),
    (slice(0, 4), b"\x1aE\xdf\xa3", "matroska"),
    (slice(0, 4), b"RIFF", "avi"),
)
"""Bytes by which containers of videos are recognised, and FFmpeg's names for them. It would itself
recognise a hundred more, among them texts that name addresses and other files to open."""
VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi")
"""Suffixes of the files that are decoded as videos."""


def is_video(path: str | os.PathLike[str]) -> bool:
    """Whether the name is that of a video."""
    return Path(path).suffix.lower() in VIDEO_SUFFIXES


def frames(paths: Sequence[str], every: int, transfer: str = "none") -> Iterator[Image]:
    """Every ``every``-th frame of all the files ``paths``, numbered through from the first.

    Raises InputError for a file that cannot be read; before the first frame if a file is missing.
    """
    for path in paths:
        if not os.path.isfile(path):
            raise InputError(f"'{path}': expected an image or a video, got no such file")
    return _every(paths, every, transfer)


def _every(paths: Sequence[str], every: int, transfer: str) -> Iterator[Image]:
    count = 0
    for path in paths:
        if is_video(path):
            for number, values in _video_frames(path):
                if count % every == 0:
                    yield _image(values, f"{path}#{number}", transfer)
                count += 1
            continue
        if count % every == 0:
            yield read_image(path, transfer=transfer)
        count += 1


def _image(values: np.ndarray, name: str, transfer: str) -> Image:
    linear = decode(values.astype(np.float32) / np.float32(LEVELS), transfer)
    return Image(np.asarray(linear), 1 / LEVELS, transfer, name, "")


def _video_frames(path: str) -> Iterator[tuple[int, np.ndarray]]:
    """(number from 1, (h, w, 3) bytes) of every frame; decoded one at a time."""
    try:
        # Imported here: FFmpeg is needed for videos alone.
        import av

        with open(path, "rb") as file:
            head = file.read(8)
            name = next((name for place, magic, name in CONTAINERS if head[place] == magic), None)
            if name is None:
                raise InputError(
                    f"'{path}': expected a video (MP4, MOV, MKV, WebM or AVI), got another file"
                )
            file.seek(0)
            # As an open file and not as a name: nothing else is opened.
            with av.open(file, "r", format=name) as container:
                frames = container.decode(video=0)
                for number, frame in enumerate(frames, 1):
                    if number == 1:
                        check_pixels((frame.height, frame.width))
                    yield number, frame.to_ndarray(format="rgb24")
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"'{path}': out of memory; expected a smaller video") from None
    except ImportError as error:
        raise InputError(
            f"'{path}': a video needs the package av, which is not installed; "
            "pip install 'godfit[video]', or give its frames as images"
        ) from error
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"'{path}': expected a video, got {reason}") from error
