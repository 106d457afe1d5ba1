import errno
import hashlib
import io
import os
import struct
import subprocess
import sys
import zlib

import imagecodecs
import jax
import jax.numpy as jnp
import numpy as np
import OpenEXR
import PIL.Image
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from godfit.io.image import MAX_PIXELS, Image, InputError, decode, encode, read_image, write_image
from godfit.runtime.files import atomic_write
from tests.support.paths import ROOT

RNG = np.random.default_rng(20240229)
H, W = 11, 13
GREY8 = RNG.integers(0, 256, (H, W), dtype=np.uint8)
RGB8 = RNG.integers(0, 256, (H, W, 3), dtype=np.uint8)
GREY16 = RNG.integers(0, 65536, (H, W), dtype=np.uint16)
RGB16 = RNG.integers(0, 65536, (H, W, 3), dtype=np.uint16)
RGBF = RNG.normal(1, 3, (H, W, 3)).astype(np.float32)
ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2))
ADAM7 += ((0, 1, 1, 2),)


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(codes: np.ndarray, bits: int, colour: int, extra: bytes = b"", interlace=False) -> bytes:
    """A PNG file written from the specification, independent of every library."""

    def scanlines(part: np.ndarray) -> bytes:
        out = b""
        for row in part.reshape(len(part), -1):
            if bits == 16:
                line = row.astype(">u2").tobytes()
            else:
                each = np.unpackbits(row.astype(np.uint8)[:, None], axis=1)[:, 8 - bits :]
                line = np.packbits(each.ravel()).tobytes()
            out += b"\0" + line
        return out

    if interlace:
        parts = (codes[y::dy, x::dx] for x, y, dx, dy in ADAM7)
        raw = b"".join(scanlines(part) for part in parts if part.size)
    else:
        raw = scanlines(codes)
    height, width = codes.shape[:2]
    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, int(interlace))
    body = chunk(b"IHDR", head) + extra + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def jpeg(codes: np.ndarray, mode: str | None = None, **options) -> bytes:
    stream = io.BytesIO()
    picture = PIL.Image.fromarray(codes)
    (picture.convert(mode) if mode else picture).save(stream, "JPEG", **options)
    return stream.getvalue()


def tiff(codes: np.ndarray, **options) -> bytes:
    stream = io.BytesIO()
    options.setdefault("photometric", "rgb" if codes.shape[-1] == 3 else "minisblack")
    tifffile.imwrite(stream, codes, **options)
    return stream.getvalue()


def exr(channels: dict, **header) -> bytes:
    stream = io.BytesIO()
    header.setdefault("compression", OpenEXR.ZIP_COMPRESSION)
    OpenEXR.File(header, channels).write(stream)
    return stream.getvalue()


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


@pytest.fixture
def load(tmp_path):
    def load(data: bytes, **options) -> Image:
        path = tmp_path / "image.dat"  # the name says nothing: the content decides
        path.write_bytes(data)
        return read_image(path, **options)

    return load


@pytest.fixture
def refuse(tmp_path, load):
    def refuse(data: bytes, *words: str) -> None:
        with pytest.raises(InputError) as caught:
            load(data)
        message = str(caught.value)
        assert len(message.splitlines()) == 1
        assert str(tmp_path / "image.dat") in message
        for word in words:
            assert word in message

    return refuse


def check(found: Image, codes: np.ndarray, top: int | None) -> None:
    """The image must hold exactly these codes."""
    assert found.values.dtype == np.float32
    assert found.quantum == (None if top is None else 1 / top)
    expected = codes.astype(np.float32) / np.float32(top or 1)
    np.testing.assert_array_equal(found.values, expected, strict=True)


# PNG


@pytest.mark.parametrize("interlace", [False, True])
@pytest.mark.parametrize(
    ("colour", "bits"),
    [(0, 1), (0, 2), (0, 4), (0, 8), (0, 16), (2, 8), (2, 16), (4, 8), (4, 16), (6, 8), (6, 16)],
)
def test_png_keeps_every_bit(load, capfd, colour, bits, interlace):
    channels = {0: (), 2: (3,), 4: (2,), 6: (4,)}[colour]
    codes = RNG.integers(0, 2**bits, (H, W, *channels))
    codes[0] = 2**bits - 1
    gamma = chunk(b"gAMA", struct.pack(">I", 100000))  # must change nothing
    found = load(png(codes, bits, colour, gamma, interlace))
    assert capfd.readouterr() == ("", "")
    colours = codes[..., 0] if colour == 4 else codes[..., :3] if colour == 6 else codes
    top = 65535 if bits == 16 else 255
    check(found, colours * (255 // (2**bits - 1)) if bits < 8 else colours, top)
    assert any("alpha" in note for note in found.notes) == (colour in (4, 6))
    assert any("grey levels" in note for note in found.notes) == (bits < 8)


def test_png_full_alpha_needs_no_note(load):
    codes = np.dstack([RGB16, np.full((H, W), 65535, np.uint16)])
    found = load(png(codes, 16, 6))
    check(found, RGB16, 65535)
    assert found.notes == ()


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
@pytest.mark.parametrize("transparent", [False, True])
def test_png_palette(load, bits, transparent):
    palette = RNG.integers(0, 256, (2**bits, 3), dtype=np.uint8)
    codes = RNG.integers(0, 2**bits, (H, W))
    codes[0, :2] = 0, 1
    extra = chunk(b"PLTE", palette.tobytes()) + transparent * chunk(b"tRNS", b"\x80")
    found = load(png(codes, bits, 3, extra))
    check(found, palette[codes], 255)
    assert any("palette" in note for note in found.notes)
    assert any("alpha" in note for note in found.notes) == transparent


def test_png_three_equal_channels_stay_three(load):
    check(load(png(np.dstack([GREY8] * 3), 8, 2)), np.dstack([GREY8] * 3), 255)


def test_png_animation_and_damage_are_refused(refuse):
    still = png(RGB8, 8, 2)
    refuse(png(RGB8, 8, 2, chunk(b"acTL", struct.pack(">II", 2, 0))), "animation")
    for place in (20, 60, len(still) - 2):
        damaged = bytearray(still)
        damaged[place] ^= 1
        refuse(bytes(damaged), "damaged")


# JPEG


@pytest.mark.parametrize("progressive", [False, True])
def test_jpeg(load, progressive):
    smooth = np.add.outer(np.arange(40) * 3, np.arange(56) * 2).astype(np.uint8)
    colour = np.dstack([smooth, smooth[::-1], 255 - smooth])
    for codes in (smooth, colour):
        found = load(jpeg(codes, quality=98, subsampling=0, progressive=progressive))
        assert found.values.shape == codes.shape
        assert found.quantum == 1 / 255
        assert np.abs(found.values * 255 - codes).max() <= 4
        assert any("lossy" in note for note in found.notes)
        assert len(found.notes) == 1


def test_jpeg_orientation_is_told(load):
    exif = PIL.Image.Exif()
    exif[274] = 3
    assert any("orientation" in note for note in load(jpeg(RGB8, exif=exif)).notes)


def test_jpeg_not_grey_or_rgb_is_refused(refuse):
    refuse(jpeg(RGB8, "CMYK"), "CMYK")
    refuse(imagecodecs.jpeg8_encode(RGB16 >> 4, bitspersample=12, level=95), "12-bit")


# TIFF


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": "zlib", "predictor": True, "rowsperstrip": 4},
        {"compression": "lzw", "rowsperstrip": 4},
        {"compression": "packbits"},
        {"compression": "lzma"},
        {"compression": "zstd"},
        {"tile": (16, 16), "compression": "zlib"},
        {"byteorder": ">"},
        {"bigtiff": True},
        {"planarconfig": "separate"},
    ],
)
def test_tiff_keeps_every_bit(load, options):
    for codes, top in ((RGB8, 255), (RGB16, 65535), (RGBF, None), (RGBF.astype("f2"), None)):
        if options.get("predictor") and codes.dtype.kind == "f":
            options = {**options, "predictor": 3}
        stored = np.moveaxis(codes, -1, 0) if "planarconfig" in options else codes
        found = load(tiff(stored, photometric="rgb", **options))
        check(found, codes, top)
        assert found.notes == ()


def test_tiff_grey_and_alpha(load):
    check(load(tiff(GREY8)), GREY8, 255)
    check(load(tiff(GREY16)), GREY16, 65535)
    found = load(tiff(np.dstack([RGB16, GREY16]), photometric="rgb", extrasamples=["unassalpha"]))
    check(found, RGB16, 65535)
    assert any("alpha" in note for note in found.notes)
    tag = (274, "H", 1, 6, True)
    assert any("orientation" in note for note in load(tiff(GREY8, extratags=[tag])).notes)


def test_tiff_of_64_bit_floats_tells_the_rounding(load):
    found = load(tiff(RGBF.astype(np.float64)))
    check(found, RGBF, None)
    assert any("64-bit" in note for note in found.notes)


def test_tiff_which_would_be_misread_is_refused(refuse):
    refuse(tiff(np.stack([GREY8, GREY8])), "one page")
    refuse(tiff(np.stack([GREY8, GREY8]))[:-200], "one page")  # the second page is cut
    refuse(tiff(GREY8, photometric="miniswhite"), "grey or RGB")
    refuse(tiff(GREY8, photometric="palette", colormap=np.zeros((3, 256), "u2")), "grey or RGB")
    refuse(tiff(np.dstack([RGB8, GREY8]), photometric="separated"), "grey or RGB")
    refuse(tiff(RGB8, photometric="rgb", compression="jpeg"), "grey or RGB")
    refuse(tiff(RGB8, photometric="minisblack", planarconfig="contig"), "3 samples")
    refuse(tiff(GREY8, compression="jpeg"), "lossless")
    refuse(tiff(GREY8 > 127, photometric="minisblack"), "1 bits")
    refuse(tiff(GREY16 >> 4, bitspersample=12), "12 bits")
    refuse(tiff(GREY16.astype(np.int16)), "int16")
    refuse(tiff(GREY16.astype(np.uint32)), "uint32")


def test_tiff_missing_strip_is_refused(refuse):
    data = tiff(GREY8, rowsperstrip=4)
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        tag = file.pages.first.tags["StripByteCounts"]
        assert tag.count == 3
        start, step = tag.valueoffset, tag.valuebytecount // 3
    refuse(data[:start] + bytes(step) + data[start + step :], "missing strips")
    entry = data.index(struct.pack("<H", 273))  # StripOffsets: pretend that there are two
    assert struct.unpack("<HI", data[entry + 2 : entry + 8]) == (4, 3)
    refuse(patch(data, entry + 4, struct.pack("<I", 2)), "missing strips")


# EXR


@pytest.mark.parametrize("kind", [np.float16, np.float32])
@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ"])
def test_exr_keeps_every_bit(load, kind, compression):
    codes = RGBF.astype(kind)
    method = getattr(OpenEXR, compression + "_COMPRESSION")
    for channels, expected in (
        ({"RGB": codes}, codes),
        ({"Y": codes[..., 0].copy()}, codes[..., 0]),
        ({"RGBA": np.dstack([codes, np.ones((H, W), kind)])}, codes),
    ):
        found = load(exr(channels, compression=method))
        check(found, expected, None)
        assert found.notes == ()


def test_exr_notes(load):
    grey = RGBF[..., 0].copy()
    found = load(exr({"Y": grey, "A": grey}))
    check(found, grey, None)
    assert any("alpha" in note for note in found.notes)
    found = load(exr({"RGB": RGBF, "Z": grey}))
    check(found, RGBF, None)
    assert any("Z" in note for note in found.notes)
    box = np.array([0, 0], "i4"), np.array([99, 99], "i4")
    assert any("display window" in note for note in load(exr({"Y": grey}, displayWindow=box)).notes)


def test_exr_tiled(load):
    tiles = OpenEXR.TileDescription()
    check(load(exr({"RGB": RGBF}, type=OpenEXR.tiledimage, tiles=tiles)), RGBF, None)


def test_exr_which_would_be_misread_is_refused(refuse):
    grey = RGBF[..., 0].copy()
    refuse(exr({"Z": grey}), "channels")
    refuse(exr({"Y": grey, "RY": grey, "BY": grey}), "channels")
    refuse(exr({"R": grey, "G": grey.astype("f2"), "B": grey}), "channel")
    refuse(exr({"Y": GREY8.astype(np.uint32)}), "uint32")
    stream = io.BytesIO()
    OpenEXR.File([OpenEXR.Part({}, {"Y": grey}, name) for name in "ab"]).write(stream)
    refuse(stream.getvalue(), "one part")


# .npy


@pytest.mark.parametrize("kind", ["u1", "<u2", ">u2", "<f2", "<f4", ">f4", "<f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_npy(load, kind, order):
    top = {"u1": 255, "u2": 65535}.get(kind[-2:])
    codes = (RGB16 >> (8 if kind == "u1" else 0) if top else RGBF).astype(kind)
    found = load(npy(np.asarray(codes, order=order)))
    check(found, codes, top)
    assert bool(found.notes) == (kind == "<f8")


def test_npy_shapes(load):
    check(load(npy(GREY8)), GREY8, 255)
    check(load(npy(GREY8[..., None])), GREY8, 255)
    check(load(npy(np.dstack([GREY8, GREY8]))), GREY8, 255)
    check(load(npy(np.dstack([RGB16, GREY16]))), RGB16, 65535)
    check(load(npy(-np.ones((1, 1)))), -np.ones((1, 1)), None)


@pytest.mark.parametrize(
    "array",
    [
        np.array(1.0),
        np.ones(5),
        np.ones((2, 2, 5)),
        np.ones((2, 2, 3, 1)),
        np.ones((0, 4)),
        np.ones((4, 0, 3)),
        np.ones((4, 4, 0)),
        np.ones((2, 2), bool),
        np.ones((2, 2), complex),
        np.ones((2, 2), np.int64),
        np.ones((2, 2), np.int8),
        np.ones((2, 2), np.uint32),
        np.ones((2, 2), np.longdouble),
        np.array([["a", "b"]]),
        np.array([[None, 1]]),
        np.zeros((2, 2), [("a", "f4"), ("b", "f4")]),
    ],
)
def test_npy_of_other_shapes_and_types_is_refused(refuse, array):
    refuse(npy(array), "expected")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e39])
def test_values_which_are_not_finite_are_refused(refuse, bad):
    array = np.ones((3, 3))
    array[1, 2] = bad
    refuse(npy(array), "finite")
    if bad != 1e39:
        refuse(exr({"Y": array.astype(np.float32)}), "finite")
        refuse(tiff(array.astype(np.float32)), "finite")


# Whole files or none

WHOLE = {
    "PNG": png(RGB16, 16, 2),
    "interlaced PNG": png(RGB16, 16, 2, interlace=True),
    "JPEG": jpeg(RGB8, quality=90),
    "progressive JPEG": jpeg(RGB8, quality=90, progressive=True),
    "TIFF": tiff(RGB16),
    "LZW TIFF": tiff(RGB16, compression="lzw"),
    "LZMA TIFF": tiff(RGB16, compression="lzma"),
    "tiled TIFF": tiff(RGB16, tile=(16, 16), compression="zlib"),
    "EXR": exr({"RGB": RGBF}),
    "plain EXR": exr({"RGB": RGBF}, compression=OpenEXR.NO_COMPRESSION),
    "npy": npy(RGBF),
}


@pytest.mark.parametrize("name", WHOLE)
def test_cut_files_are_refused_without_chatter(load, refuse, capfd, name):
    data = WHOLE[name]
    load(data)
    for length in (len(data) - 1, len(data) - 7, len(data) * 3 // 4, len(data) // 3, 30, 9):
        refuse(data[:length])
    assert capfd.readouterr() == ("", "")


def test_cut_pixels_are_named_as_such(refuse):
    refuse(WHOLE["EXR"][:-1], "cut short")
    refuse(WHOLE["npy"][:-4], "bytes of samples")
    refuse(WHOLE["npy"] + bytes(4), "bytes of samples")


def patch(data: bytes, place: int, new: bytes) -> bytes:
    return data[:place] + new + data[place + len(new) :]


def test_headers_claiming_too_many_pixels_are_refused_before_decoding(refuse, monkeypatch):
    def decoder(*_, **__):
        raise AssertionError("decoded")

    head = struct.pack(">IIBBBBB", 2**15, 2**14 + 1, 8, 0, 0, 0, 0)
    bomb = png(GREY8, 8, 0)[:8] + chunk(b"IHDR", head) + png(GREY8, 8, 0)[33:]
    sof = WHOLE["JPEG"].index(b"\xff\xc0")
    window = WHOLE["EXR"].index(b"dataWindow\0box2i\0") + 21
    with tifffile.TiffFile(io.BytesIO(WHOLE["TIFF"])) as file:
        tags = file.pages.first.tags
        places = [tags[name].offset + 8 for name in ("ImageWidth", "ImageLength")]
    big = WHOLE["TIFF"]
    for place in places:
        big = patch(big, place, struct.pack("<H", 60000))
    monkeypatch.setattr(imagecodecs, "png_decode", decoder)
    monkeypatch.setattr(tifffile.TiffPage, "asarray", decoder)
    monkeypatch.setattr(PIL.Image.Image, "load", decoder)
    refuse(bomb, str(MAX_PIXELS), "32768")
    refuse(patch(WHOLE["JPEG"], sof + 5, b"\xff\xff\xff\xff"), str(MAX_PIXELS), "65535")
    refuse(patch(WHOLE["EXR"], window, struct.pack("<iiii", 0, 0, 59999, 59999)), "60000")
    refuse(big, str(MAX_PIXELS), "60000")
    text = npy(np.zeros((2, 2), np.float32))
    refuse(text.replace(b"(2, 2), }  ", b"(50000, 50000), }  ")[: len(text)], "50000")


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (b"", "empty"),
        (b"hello, this is a text\nof two lines\n", "hello"),
        (b"8BPS" + bytes(50), "Photoshop"),
        (b"\0\0\0\x20ftypisom" + bytes(50), "a video"),
        (b"%PDF-1.7\n", "PDF"),
    ],
)
def test_other_contents_are_refused_naming_what_is_accepted(refuse, data, word):
    refuse(data, word, "PNG, JPEG, TIFF, EXR")


@pytest.mark.parametrize("name", ["missing.png", "", "a\nb.png", "a\0b.png", "x" * 300])
def test_unreadable_paths(tmp_path, name):
    with pytest.raises(InputError) as caught:
        read_image(tmp_path / name if name else tmp_path)  # "": the folder itself
    assert len(str(caught.value).splitlines()) == 1
    assert str(tmp_path) in str(caught.value)


def test_bytes_and_transfer_are_kept_beside_the_values(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(WHOLE["PNG"])
    found = read_image(path, transfer="srgb")
    assert found.path == str(path)
    assert found.transfer == "srgb"
    assert found.sha256 == hashlib.sha256(WHOLE["PNG"]).hexdigest()
    assert read_image(str(path)).path == str(path)
    with pytest.raises(InputError, match="gamma"):
        read_image(path, transfer="gamma")


def test_heavy_readers_are_imported_only_when_needed():
    code = (
        "import sys, godfit.io.image; "
        "print(*{'tifffile', 'OpenEXR', 'imagecodecs', 'PIL', 'jax'} & {*sys.modules})"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "\n", "")


# Transfer


def test_srgb_known_values():
    x = np.array([-1.0, 0.0, 0.04045, 0.5, 1.0])
    expected = [-1 / 12.92, 0.0, 0.0031308, 0.21404114048223255, 1.0]
    np.testing.assert_allclose(decode(x, "srgb"), expected, rtol=2e-6, atol=0)
    np.testing.assert_allclose(encode(np.array(expected), "srgb"), x, rtol=2e-6, atol=0)
    assert decode(np.array(1.5), "srgb") == pytest.approx((1.555 / 1.055) ** 2.4, rel=1e-12)
    assert decode(x, "none") is x
    assert encode(x, "none") is x


@given(st.floats(-10, 10).filter(lambda v: not 0.0404 < v < 0.0405))
def test_srgb_roundtrip(v):
    assert encode(decode(np.array(v), "srgb"), "srgb") == pytest.approx(v, rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("bits", [8, 16])
def test_srgb_keeps_the_codes(load, bits):
    codes = np.arange(2**bits, dtype=f"u{bits // 8}").reshape(16, -1)
    found = load(npy(codes), transfer="srgb")
    top = 2**bits - 1
    assert found.values.dtype == found.encoded.dtype == np.float32
    assert (np.diff(found.values.ravel()) > 0).all()
    np.testing.assert_allclose(
        found.values, decode(codes / top, "srgb"), rtol=1e-7, atol=0, strict=False
    )
    scaled = found.encoded.astype(np.float64) * top
    assert np.abs(scaled - codes).max() < (1e-4 if bits == 8 else 1e-2)


def test_srgb_applies_to_float_files_too(load):
    found = load(exr({"RGB": RGBF}), transfer="srgb")
    assert found.quantum is None
    np.testing.assert_allclose(found.values, decode(RGBF.astype("f8"), "srgb"), rtol=1e-6)
    np.testing.assert_allclose(found.encoded, RGBF, rtol=1e-5)


@pytest.mark.parametrize("function", [decode, encode])
def test_jax_gradients_are_finite_and_right(function):
    x = jnp.array([-1.0, -1e-30, 0.0, 1e-30, 0.001, 0.04045, 0.0031308, 0.3, 1.0, 7.0])
    gradient = jax.vmap(jax.jit(jax.grad(lambda v: function(v, "srgb"))))(x)
    assert jnp.isfinite(gradient).all()
    slope = 1 / 12.92 if function is decode else 12.92
    np.testing.assert_allclose(gradient[:5], [slope] * 5, rtol=1e-6)
    assert (gradient > 0).all()
    step = 1e-3
    for at in (0.3, 7.0):
        ends = function(jnp.array([at - step, at + step]), "srgb")
        exact = gradient[7] if at == 0.3 else gradient[9]
        np.testing.assert_allclose((ends[1] - ends[0]) / (2 * step), exact, rtol=1e-3)
    numpy = function(np.asarray(x), "srgb")
    np.testing.assert_allclose(jax.jit(lambda v: function(v, "srgb"))(x), numpy, rtol=1e-5)


def test_unknown_transfer():
    for function in (decode, encode):
        with pytest.raises(InputError, match="gamma"):
            function(np.ones(2), "gamma")


# Writing

SHAPES = st.tuples(st.integers(1, 5), st.integers(1, 5)) | st.tuples(
    st.integers(1, 5), st.integers(1, 5), st.just(3)
)


@settings(max_examples=50, deadline=None)
@given(st.data(), st.sampled_from([8, 16]), st.sampled_from(["none", "srgb"]))
def test_png_roundtrip_is_exact(tmp_path_factory, data, bits, transfer):
    codes = data.draw(hnp.arrays(f"u{bits // 8}", SHAPES))
    folder = tmp_path_factory.mktemp("roundtrip")
    path, again = folder / "a.PNG", folder / "b.png"
    top = 2**bits - 1
    write_image(path, decode(codes / top, transfer), transfer=transfer, bits=bits)
    assert path.read_bytes()[24] == bits
    found = read_image(path, transfer=transfer)
    assert found.quantum == 1 / top
    np.testing.assert_array_equal(np.rint(found.encoded * np.float32(top)), codes, strict=False)
    write_image(again, found.values, transfer=transfer, bits=bits)  # from float32, too
    assert again.read_bytes() == path.read_bytes()


def test_png_clips_and_rounds_half_up(tmp_path):
    path = tmp_path / "a.png"
    values = np.array([[-3.0, 0.0, 0.5, 1.0, 2.0, 1.5 / 255 + 1e-5, 1.5 / 255 - 1e-5]])
    write_image(path, values)
    assert (read_image(path).values * 255).round().tolist() == [[0, 0, 128, 255, 255, 2, 1]]
    write_image(path, jnp.asarray(values), bits=16)
    assert (read_image(path).values * 65535).round()[0, :5].tolist() == [0, 0, 32768, 65535, 65535]


@settings(max_examples=30, deadline=None)
@given(
    hnp.arrays("f4", SHAPES, elements=st.floats(width=32, allow_nan=False, allow_infinity=False))
)
def test_npy_roundtrip_is_exact(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("roundtrip") / "a.npy"
    write_image(path, values, transfer="srgb", bits=16)
    found = read_image(path)
    np.testing.assert_array_equal(found.values, values, strict=True)
    assert found.encoded is found.values


@pytest.mark.parametrize(
    ("name", "values", "options"),
    [
        ("a.jpg", GREY8 / 255, {}),
        ("a", GREY8 / 255, {}),
        ("a.png", GREY8 / 255, {"bits": 12}),
        ("a.png", GREY8 / 255, {"transfer": "gamma"}),
        ("a.png", np.ones(3), {}),
        ("a.png", np.ones((3, 3, 4)), {}),
        ("a.png", np.ones((3, 0)), {}),
        ("a.png", np.ones((3, 3), complex), {}),
        ("a.png", np.full((3, 3), np.nan), {}),
        ("a.npy", np.full((3, 3), 1e39), {}),
        ("none/a.png", GREY8 / 255, {}),
        ("none/a.npy", GREY8 / 255, {}),
        ("x" * 300 + ".png", GREY8 / 255, {}),
        ("a\0.png", GREY8 / 255, {}),
        ("folder.png", GREY8 / 255, {}),
    ],
)
def test_refusing_to_write_leaves_nothing(tmp_path, name, values, options):
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(InputError) as caught:
        write_image(tmp_path / name, values, **options)
    assert len(str(caught.value).splitlines()) == 1
    assert os.listdir(tmp_path) == ["folder.png"]


@pytest.mark.parametrize("function", ["fsync", "replace"])
def test_a_failure_half_way_leaves_the_old_file_alone(tmp_path, monkeypatch, function):
    path = tmp_path / "a.png"
    path.write_bytes(b"old")
    for error in (OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()):

        def fail(*_, error=error):
            assert len(os.listdir(tmp_path)) == 2  # the temporary is in the same folder
            raise error

        monkeypatch.setattr(os, function, fail)
        with pytest.raises(type(error)) as caught:
            atomic_write(path, b"new")
        assert caught.value is error  # untouched
        with pytest.raises(InputError if isinstance(error, OSError) else KeyboardInterrupt):
            write_image(path, GREY8 / 255)
        assert os.listdir(tmp_path) == ["a.png"]
        assert path.read_bytes() == b"old"


def test_atomic_write_permissions_and_relative_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "a.json"
    old = os.umask(0o027)
    try:
        atomic_write("a.json", b"one")
        assert path.stat().st_mode & 0o777 == 0o640
        atomic_write("a.json", b"2")
    finally:
        os.umask(old)
    assert path.read_bytes() == b"2"
    assert os.listdir(tmp_path) == ["a.json"]


def test_errors_never_hold_a_newline():
    assert str(InputError("a\nb\r\nc\u2028d")) == "a b c d"
    assert issubclass(InputError, ValueError)


def test_png_chunks_that_no_decoder_takes_are_named(refuse):
    whole = png(GREY8, 8, 0)
    refuse(whole[:8] + chunk(b"CgBI", bytes(4)) + whole[8:], "iOS")
    refuse(whole[:8] + chunk(b"IHDR", b"") + whole[33:], "IHDR")
    refuse(whole[:8] + chunk(b"tEXt", b"") + whole[8:], "IHDR first")
