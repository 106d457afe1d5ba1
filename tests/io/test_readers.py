"""Formats that need one library call: every bit of each is kept, or a note says that it is not."""

import io
import struct

import imagecodecs
import netpbmfile
import numpy as np
import PIL.Image
import pytest

from godfit.errors import InputError
from godfit.io.frames import frames, is_video
from godfit.io.image import read_image, write_image

RNG = np.random.default_rng(57)
RGB = RNG.integers(0, 256, (9, 14, 3), dtype=np.uint8)
GREY = RGB[..., 0]
WORDS = RNG.integers(0, 65536, (9, 14, 3), dtype=np.uint16)
TEN_BITS = RNG.integers(0, 1024, (9, 14), dtype=np.uint16)


def pillow(codes, kind, **options) -> bytes:
    stream = io.BytesIO()
    PIL.Image.fromarray(codes).save(stream, kind, **options)
    return stream.getvalue()


def netpbm(codes, **options) -> bytes:
    stream = io.BytesIO()
    netpbmfile.imwrite(stream, codes, **options)
    return stream.getvalue()


def radiance(mantissas: np.ndarray, exponent: int) -> bytes:
    """A Radiance file without run lengths: a mantissa each and one shared exponent."""
    h, w = mantissas.shape[:2]
    cells = np.concatenate([mantissas, np.full((h, w, 1), exponent, np.uint8)], -1)
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (h, w) + cells.tobytes()


def bottom_up_floats(values: np.ndarray) -> bytes:
    """A PFM file: rows from the bottom, little-endian where the scale is negative."""
    h, w = values.shape[:2]
    kind = b"PF" if values.ndim == 3 else b"Pf"
    return kind + b"\n%d %d\n-1.0\n" % (w, h) + values[::-1].astype("<f4").tobytes()


FLOATS = RNG.normal(1, 2, (9, 14, 3)).astype(np.float32)
EXACT = {
    "BMP": (pillow(RGB, "BMP"), RGB, 255),
    "TGA": (pillow(RGB, "TGA"), RGB, 255),
    "TGA, run lengths": (pillow(RGB, "TGA", compression="tga_rle"), RGB, 255),
    "QOI": (imagecodecs.qoi_encode(RGB), RGB, 255),
    "lossless WebP": (pillow(RGB, "WEBP", lossless=True), RGB, 255),
    "PPM": (netpbm(RGB), RGB, 255),
    "PPM, 16 bits": (netpbm(WORDS), WORDS, 65535),
    "PGM": (netpbm(GREY), GREY, 255),
    "PGM, 10 bits": (netpbm(TEN_BITS, maxval=1023), TEN_BITS, 1023),
    "PGM, text": (b"P2\n# text\n3 1\n9\n0 4 9\n", np.array([[0, 4, 9]]), 9),
    "PFM": (bottom_up_floats(FLOATS[..., 1]), FLOATS[..., 1], None),
    "PFM, colour": (bottom_up_floats(FLOATS), FLOATS, None),
    "JPEG 2000": (imagecodecs.jpeg2k_encode(RGB, level=0, reversible=True), RGB, 255),
    "JPEG 2000, 12 bits": (
        imagecodecs.jpeg2k_encode(WORDS[..., 0] >> 4, level=0, reversible=True, bitspersample=12),
        WORDS[..., 0] >> 4,
        4095,
    ),
    "Radiance HDR": (radiance(RGB, 129), RGB.astype(np.float64) / 256 * 2, None),
}


@pytest.mark.parametrize("kind", EXACT)
def test_every_bit_is_kept(tmp_path, kind):
    data, codes, top = EXACT[kind]
    path = tmp_path / ("image.tga" if "TGA" in kind else "image.dat")
    path.write_bytes(data)
    found = read_image(path)
    assert found.quantum == (None if top is None else 1 / top)
    np.testing.assert_allclose(found.values, codes / (top or 1), rtol=2e-7, atol=0)


@pytest.mark.parametrize("kind", EXACT)
def test_cut_files_are_one_line(tmp_path, kind):
    data = EXACT[kind][0]
    path = tmp_path / ("image.tga" if "TGA" in kind else "image.dat")
    path.write_bytes(data[: len(data) * 2 // 3])
    with pytest.raises(InputError) as caught:
        read_image(path)
    assert len(str(caught.value).splitlines()) == 1
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (pillow(RGB, "WEBP", quality=90), "WebP is lossy"),
        (pillow(RGB, "AVIF", quality=90), "AVIF is lossy"),
        (pillow(RGB, "GIF"), "palette"),
    ],
)
def test_what_loses_bits_says_so(tmp_path, data, words):
    path = tmp_path / "image"
    path.write_bytes(data)
    found = read_image(path)
    assert found.values.shape == (9, 14, 3)
    assert any(words in note for note in found.notes)


def test_avif_of_ten_bits_has_their_step(tmp_path):
    path = tmp_path / "image.avif"
    smooth = np.add.outer(np.arange(32), np.arange(32)).astype(np.uint16) * 16
    rgb = np.repeat(smooth[..., None], 3, -1)
    path.write_bytes(imagecodecs.avif_encode(rgb, level=95, bitspersample=10))
    found = read_image(path)
    assert found.quantum == 1 / 1023
    np.testing.assert_allclose(found.values, rgb / 1023, atol=0.02)


@pytest.mark.parametrize("kind", ["GIF", "PNG", "WEBP"])
def test_an_animation_is_a_clip(tmp_path, kind):
    shots = [np.full((6, 8, 3), 40 * i, np.uint8) for i in range(1, 4)]
    first, *rest = map(PIL.Image.fromarray, shots)
    path = tmp_path / "clip.dat"
    options = {"lossless": True} if kind == "WEBP" else {}
    first.save(path, kind, save_all=True, append_images=rest, **options)
    assert is_video(path)
    found = list(frames([str(path)], 1))
    assert [round(float(image.values.max()) * 255) for image in found] == [40, 80, 120]
    still = tmp_path / "still.dat"
    first.save(still, kind)
    assert not is_video(still)


def test_exr_is_written_and_read_again(tmp_path):
    for name, values in (("grey.exr", FLOATS[..., 0]), ("rgb.exr", FLOATS)):
        write_image(tmp_path / name, values)
        np.testing.assert_array_equal(read_image(tmp_path / name).values, values)


def test_other_formats_are_named(tmp_path):
    path = tmp_path / "image.heic"
    path.write_bytes(struct.pack(">I", 24) + b"ftypheic" + bytes(40))
    with pytest.raises(InputError, match="HEIC"):
        read_image(path)
