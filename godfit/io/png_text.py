"""A line of text in a PNG that says how its values were computed.

A picture that this program renders differs from the model by the rounding of its levels alone. One
from a GPU differs by more, see ``godfit/inference/allowances``. The chunk tEXt holds a keyword and
a text (PNG, third edition, section 11.3.3).
"""

from __future__ import annotations

import zlib

KEYWORD = b"Arithmetic"
"""Keyword of the text."""
EXACT = b"exact"
"""Text of a picture that only its rounding separates from the model."""
SIGNATURE = b"\x89PNG\r\n\x1a\n"
"""First bytes of a PNG."""
HEADER_END = 33
"""Byte at which the second chunk begins: behind the signature and the header's 25 bytes."""
_BODY = b"tEXt" + KEYWORD + b"\0" + EXACT
_CHUNK = (len(_BODY) - 4).to_bytes(4, "big") + _BODY + zlib.crc32(_BODY).to_bytes(4, "big")


def as_exact(data: bytes) -> bytes:
    """The bytes of a PNG with the text behind its header; other files as they are."""
    if not data.startswith(SIGNATURE):
        return data
    return data[:HEADER_END] + _CHUNK + data[HEADER_END:]


def is_exact(data: bytes) -> bool:
    """Whether the file is a PNG with that text among the chunks before its samples."""
    end = data.find(b"IDAT") if data.startswith(SIGNATURE) else 0
    return _CHUNK in data[: max(end, 0)]
