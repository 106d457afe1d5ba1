"""Arrays of every type are read by their meaning, or refused with the remedy."""

import struct
import zlib

import jax
import jax.numpy as jnp
import ml_dtypes
import numpy as np
import pytest

from godfit.errors import InputError
from godfit.io.arrays import as_light
from godfit.io.image import read_image, write_image
from godfit.io.sources import read_source, without_holes

CODES = np.random.default_rng(5).integers(0, 256, (12, 10), dtype=np.uint8)
LIGHT = CODES / 255


class Tensor:
    """What other libraries' arrays have."""

    def __array__(self, dtype=None, copy=None):
        return np.asarray(CODES, dtype)


SAME = {
    "bytes": CODES,
    "wide integers": CODES.astype(np.int64),
    "words": CODES.astype(np.uint16) * 257,
    "float64": LIGHT,
    "big-endian": LIGHT.astype(">f4"),
    "every other column": np.repeat(LIGHT, 2, 1)[:, ::2],
    "columns first": np.asfortranarray(LIGHT),
    "a masked array that hides nothing": np.ma.array(CODES, mask=False),
    "another library's": Tensor(),
    "a list of lists": LIGHT.tolist(),
    "JAX's bytes": jnp.asarray(CODES),
}


@pytest.mark.parametrize("kind", SAME)
def test_one_picture_in_many_types(kind):
    np.testing.assert_allclose(as_light(SAME[kind], "mask"), LIGHT, rtol=1e-6, atol=1e-7)
    found = read_source(SAME[kind], "none")
    np.testing.assert_allclose(found.values, LIGHT, rtol=1e-6, atol=1e-7)
    assert found.quantum == (1 / 65535 if kind == "words" else 1 / 255)


@pytest.mark.parametrize("dtype", [np.float16, ml_dtypes.bfloat16])
def test_short_floats_are_floats(dtype):
    short = LIGHT.astype(dtype)
    assert read_source(short, "none").quantum is None
    for array in (short, jnp.asarray(short)):
        found = as_light(array, "mask")
        assert found.dtype == jnp.float32
        np.testing.assert_array_equal(found, short.astype(np.float32))


def test_booleans_are_black_and_white():
    np.testing.assert_array_equal(as_light(CODES > 99, "mask"), (CODES > 99) * 1.0)
    np.testing.assert_array_equal(read_source(CODES > 99, "none").values, (CODES > 99) * 1.0)


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (CODES.astype(float), "divide them by 255"),
        (CODES.astype(float) * 257, "divide them by 65535"),
        (CODES.astype(np.int32) - 5, "integers from -5"),
        (CODES.astype(np.uint32) << 20, "scale them"),
        (np.ma.array(CODES, mask=CODES > 250), "masked array that hides"),
        (LIGHT.astype(complex), "complex"),
        (np.array([["a", "b"]]), "numbers"),
        ([[1.0], [1.0, 2.0]], "array of numbers"),
    ],
)
def test_other_scales_and_kinds_are_refused_with_the_remedy(array, words):
    for read in (lambda: read_source(array, "none", "mask"), lambda: as_light(array, "mask")):
        with pytest.raises(InputError, match=words) as caught:
            read()
        assert str(caught.value).startswith("mask: expected")


def test_the_light_of_high_dynamic_range_may_be_bright():
    bright = LIGHT.copy()
    bright[:2] = 200.5
    np.testing.assert_allclose(read_source(bright, "none").values, bright, rtol=1e-6)


def test_while_traced_only_types_with_one_meaning_are_taken():
    total = jax.jit(lambda mask: as_light(mask, "mask").sum())
    assert float(total(CODES)) == pytest.approx(LIGHT.sum(), rel=1e-6)
    with pytest.raises(InputError, match="int32"):
        total(CODES.astype(np.int32))


def test_floats_that_are_all_levels_have_their_step(tmp_path):
    write_image(tmp_path / "levels.npy", LIGHT)
    assert read_image(tmp_path / "levels.npy").quantum == 1 / 255
    noisy = LIGHT.copy()
    noisy[3, 4] = 0.1234567
    write_image(tmp_path / "noisy.npy", noisy)
    assert read_image(tmp_path / "noisy.npy").quantum is None


def test_holes_may_only_be_where_nothing_is_read():
    target = LIGHT.copy()
    target[2, 3], target[4, 7] = np.nan, np.inf
    with pytest.raises(InputError, match=r"in 2 of 120 pixels inside X,Y,W,H 3,2,5,3"):
        read_source(target, "none")
    found = read_source(target, "none", "target", finite=False)
    valid = np.ones(target.shape, bool)
    valid[2, 3] = False
    with pytest.raises(InputError, match=r"1 of 120 pixels inside X,Y,W,H 7,4,1,1"):
        without_holes(found, valid)
    valid[4, 7] = False
    whole = without_holes(found, valid)
    assert np.isfinite(whole.values).all()
    np.testing.assert_array_equal(whole.values[valid], found.values[valid])


def rgba(colour, alpha):
    return np.concatenate([np.broadcast_to(colour, (*alpha.shape, 3)), alpha[..., None]], -1)


def test_a_picture_in_its_alpha_channel_is_used_and_said():
    white = read_source(rgba(np.uint8(255), CODES), "none")
    np.testing.assert_allclose(white.values, np.repeat(LIGHT[..., None], 3, -1), atol=1e-6)
    assert "over black" in white.notes[0]
    black = read_source(rgba(np.uint8(0), CODES), "none")
    np.testing.assert_allclose(black.values, 1 - LIGHT, atol=1e-6)
    assert "over white" in black.notes[0]
    picture = np.random.default_rng(0).integers(0, 256, (12, 10, 3), dtype=np.uint8)
    kept = read_source(np.concatenate([picture, CODES[..., None]], -1), "none")
    np.testing.assert_allclose(kept.values, picture / 255, atol=1e-6)
    assert "dropped" in kept.notes[0]


def with_chunk(data: bytes, kind: bytes, body: bytes) -> bytes:
    """A PNG with one more chunk after its header, which has 8 + 25 bytes."""
    more = struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    return data[:33] + more + data[33:]


def test_bits_that_only_fill_up_are_no_levels(tmp_path):
    import imagecodecs

    ten = np.random.default_rng(1).integers(0, 1024, (20, 30)).astype(np.uint16)
    cases = {
        "shifted": (imagecodecs.png_encode(ten << 6), 1023, ten),
        "repeated, with sBIT": (
            with_chunk(imagecodecs.png_encode(ten << 6 | ten >> 4), b"sBIT", bytes([10])),
            1023,
            ten,
        ),
        "bytes as words": (imagecodecs.png_encode((ten >> 2) * np.uint16(257)), 255, ten >> 2),
        "words": (imagecodecs.png_encode(ten * 61), 65535, ten * 61),
    }  # fmt: skip
    for name, (data, top, codes) in cases.items():
        path = tmp_path / "image.png"
        path.write_bytes(data)
        found = read_image(path)
        assert found.quantum == 1 / top, name
        np.testing.assert_allclose(found.values, codes / top, rtol=1e-6, err_msg=name)
