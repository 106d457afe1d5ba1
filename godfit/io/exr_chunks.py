"""Whether an OpenEXR file holds all of its chunks, from its offsets alone.

OpenEXR reports a file that is cut short by text on stdout and stderr, which belong to the program
that uses this package. So such a file is found before it is decoded ("OpenEXR File Layout",
openexr.com).
"""

from __future__ import annotations

import struct

import numpy as np

HEADER_START = 8
"""Bytes before the first attribute: the magic number, and the version with its flags."""
TILED, DEEP, MULTIPART = 0x200, 0x800, 0x1000
"""Flags of the version."""
LINES_PER_CHUNK = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}
"""Scan lines in a chunk, by the number of the compression."""
SCANLINE_LEADER, TILE_LEADER = 8, 20
"""Bytes of a chunk before its data. The last four are the data's size."""


def may_be_whole(data: bytes) -> bool:
    """False for a file of one flat part of which a chunk is missing or cut. True where the chunks
    of a file are laid out in another way, or its header cannot be read."""
    try:
        flags = struct.unpack_from("<I", data, 4)[0]
        attributes, table = _attributes(data)
        if flags & (DEEP | MULTIPART):
            return True
        count = _chunk_count(attributes, bool(flags & TILED))
    except (struct.error, ValueError, KeyError):
        return True
    if count is None:
        return True
    start = table + 8 * count
    if start > len(data):
        return False
    offsets = np.frombuffer(data, "<u8", count, table)
    leader = TILE_LEADER if flags & TILED else SCANLINE_LEADER
    if not count or offsets.min() < start or offsets.max() > len(data) - leader:
        return False
    sizes = [struct.unpack_from("<i", data, at + leader - 4)[0] for at in offsets.tolist()]
    ends = offsets.astype(np.int64) + leader + np.array(sizes, np.int64)
    return min(sizes) >= 0 and int(ends.max()) <= len(data)


def _attributes(data: bytes) -> tuple[dict[bytes, bytes], int]:
    """The attributes of the header by name, and the byte at which the table of offsets begins."""
    found, at = {}, HEADER_START
    while data[at : at + 1] != b"\0":
        name_end = data.index(b"\0", at)
        kind_end = data.index(b"\0", name_end + 1)
        (size,) = struct.unpack_from("<i", data, kind_end + 1)
        first = kind_end + 5
        if size < 0 or first + size >= len(data):
            raise ValueError
        found[data[at:name_end]] = data[first : first + size]
        at = first + size
    return found, at + 1


def _chunk_count(attributes: dict[bytes, bytes], tiled: bool) -> int | None:
    """The number of chunks; None for tiles of several levels and for unknown compressions."""
    left, top, right, bottom = struct.unpack("<4i", attributes[b"dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if tiled:
        wide, high, mode = struct.unpack("<IIB", attributes[b"tiles"])
        # The lower four bits are the levels: one, or as many as halvings.
        return None if mode & 15 or not wide or not high else -(-width // wide) * -(-height // high)
    lines = LINES_PER_CHUNK.get(attributes[b"compression"][0])
    return None if lines is None else -(-height // lines)
