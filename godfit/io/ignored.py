"""Pixels that the user leaves out: rectangles, and images that are not black there."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from godfit.errors import InputError

if TYPE_CHECKING:
    import numpy as np


def is_whole(text: str) -> bool:
    """Whether a text is a whole number of a size that pixels have."""
    return re.fullmatch(r"\s*[-+]?[0-9]{1,15}\s*", text) is not None


def valid_pixels(ignore: Sequence[str], size: tuple[int, int]) -> np.ndarray | None:
    """(h, w), False inside the ``X,Y,W,H`` rectangles and where an image is not black."""
    if not ignore:
        return None
    # Imported here: the command line takes its texts apart before it needs any of these.
    import numpy as np

    from godfit.io.image import read_image

    valid = np.ones(size, bool)
    for text in ignore:
        numbers = text.split(",")
        if len(numbers) == 4 and all(map(is_whole, numbers)):
            x, y, w, h = (int(n) for n in numbers)
            if w <= 0 or h <= 0:
                raise InputError(f"--ignore: expected a width and height above 0, got '{text}'")
            valid[max(y, 0) : max(y + h, 0), max(x, 0) : max(x + w, 0)] = False
            continue
        if len(numbers) == 4 and not os.path.exists(text):
            raise InputError(
                f"--ignore: expected X,Y,W,H in whole pixels or an image, got '{text}'"
            )
        image = np.atleast_3d(read_image(text).values)
        if image.shape[:2] != size:
            raise InputError(
                f"--ignore: expected the target's {size[1]}x{size[0]} pixels, got "
                f"{image.shape[1]}x{image.shape[0]} in '{text}'"
            )
        valid &= (image <= 0).all(-1)
    return valid
