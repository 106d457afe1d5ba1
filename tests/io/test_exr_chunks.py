import io

import numpy as np
import OpenEXR
import pytest

from godfit.io.exr_chunks import may_be_whole

VALUES = np.random.default_rng(0).random((37, 21, 3)).astype(np.float32)


@pytest.mark.parametrize("tiled", [False, True])
@pytest.mark.parametrize("compression", ["NO", "ZIPS", "ZIP", "PIZ", "PXR24", "DWAA", "DWAB"])
def test_whole_files_pass_and_cut_ones_do_not(compression, tiled):
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}
    if tiled:
        tiles = OpenEXR.TileDescription()
        tiles.xSize, tiles.ySize = 8, 16
        header |= {"type": OpenEXR.tiledimage, "tiles": tiles}
    stream = io.BytesIO()
    OpenEXR.File(header, {"RGB": VALUES}).write(stream)
    data = stream.getvalue()
    assert may_be_whole(data)
    for length in (len(data) - 1, len(data) * 3 // 4, len(data) // 2):
        assert not may_be_whole(data[:length])


def test_what_is_no_exr_is_left_to_its_reader():
    assert may_be_whole(b"v/1\x01")
    assert may_be_whole(b"v/1\x01" + b"\x02\0\0\0" + b"x" * 50)
