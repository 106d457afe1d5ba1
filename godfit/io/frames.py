"""The frames of a clip, one at a time: image files in order, or the frames of a video."""

from __future__ import annotations

import contextlib
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
HEAD_BYTES = 1 << 16
"""Bytes of a file in which the sign of an animation lies: colour profiles may come before it."""
WEBP_ANIMATION = 0x02
"""Flag of an animation in WebP's extended header."""


def is_video(path: str | os.PathLike[str]) -> bool:
    """Whether the name is that of a video, or the file an image with several frames."""
    return Path(path).suffix.lower() in VIDEO_SUFFIXES or _animated(path)


def _animated(path: str | os.PathLike[str]) -> bool:
    """Whether the file is a GIF, PNG or WebP with several frames."""
    try:
        with open(path, "rb") as file:
            head = file.read(HEAD_BYTES)
    except (OSError, ValueError):
        return False
    if head.startswith(b"GIF8"):
        with contextlib.suppress(Exception), _images(path) as image:
            return getattr(image, "n_frames", 1) > 1
        return False
    # An animated PNG has its chunk acTL before any pixel, and WebP a flag in its first chunk.
    png = head.startswith(b"\x89PNG") and b"acTL" in head[: head.find(b"IDAT") + 1 or None]
    extended = head[:4] == b"RIFF" and head[8:16] == b"WEBPVP8X"
    return png or (extended and bool(head[20] & WEBP_ANIMATION))


def _images(path: str | os.PathLike[str]):
    """The file opened by the one of Pillow's readers that it is for."""
    from PIL.GifImagePlugin import GifImageFile
    from PIL.PngImagePlugin import PngImageFile
    from PIL.WebPImagePlugin import WebPImageFile

    with open(path, "rb") as file:
        head = file.read(4)
    reader = {b"GIF8": GifImageFile, b"RIFF": WebPImageFile}.get(head, PngImageFile)
    return reader(os.fspath(path))


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
            read = _animation_frames if _animated(path) else _video_frames
            for number, values in read(path):
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


def _animation_frames(path: str) -> Iterator[tuple[int, np.ndarray]]:
    """(number from 1, (h, w, 3) bytes) of every frame of an animated image, over black."""
    from PIL import Image as Pillow
    from PIL import ImageSequence

    try:
        with _images(path) as image:
            check_pixels((image.height, image.width))
            for number, frame in enumerate(ImageSequence.Iterator(image), 1):
                shown = Pillow.new("RGB", frame.size)
                whole = frame.convert("RGBA")
                shown.paste(whole, mask=whole.getchannel("A"))
                yield number, np.asarray(shown)
    except (OSError, ValueError, SyntaxError, EOFError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"'{path}': expected an animation, got {error}") from error


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
