"""Transfers: each curve against its formula, its inverse, and files with curves."""

import jax.numpy as jnp
import numpy as np
import pytest

from godfit.errors import InputError
from godfit.io.transfer import TRANSFERS, checked_transfer, decode, encode
from tests.support import distortions

FORMULAS = {
    "srgb": distortions.srgb,
    "reinhard": lambda x: x / (1 + x),
    "aces": distortions.aces,
    "filmic": lambda x: distortions.hable(2 * x) / distortions.hable(np.float64(11.2)),
    "reinhard+srgb": lambda x: distortions.srgb(x / (1 + x)),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_a_curve_is_its_formula(name):
    x = np.linspace(0, 3, 301)
    np.testing.assert_allclose(encode(x, name), FORMULAS[name](x), atol=1e-12)


@pytest.mark.parametrize("name", [*TRANSFERS, "aces+srgb"])
def test_decoding_is_the_inverse(name):
    x = np.linspace(0.001, 0.95, 200)
    np.testing.assert_allclose(decode(encode(x, name), name), x, rtol=1e-9)
    np.testing.assert_allclose(decode(encode(jnp.asarray(x), name), name), x, rtol=1e-9)
    assert np.isfinite(decode(np.linspace(0, 1, 256), name)).all()


def test_white_is_still_white_where_a_curve_has_no_end():
    white = decode(np.float32([1.0]), "reinhard")
    assert encode(white, "reinhard")[0] > (65535 - 0.5) / 65535


def test_files_hold_curves(tmp_path):
    x = np.linspace(0, 2, 33)
    rows = "\n".join(f"{y} {y} {y}" for y in np.sqrt(x / 2))
    (tmp_path / "film.cube").write_text(f"LUT_1D_SIZE 33\nDOMAIN_MAX 2 2 2\n{rows}\n")
    np.save(tmp_path / "film.npy", np.stack([x, np.sqrt(x / 2)], -1))
    at = np.linspace(0, 2, 50)
    for name in ("film.cube", "film.npy"):
        curve = checked_transfer(str(tmp_path / name))
        np.testing.assert_allclose(encode(at, curve), np.interp(at, x, np.sqrt(x / 2)))
        np.testing.assert_allclose(decode(encode(at, curve), curve), at, atol=1e-12)
        # The name has the content's hash: a changed file is another curve for stored programs.
        assert checked_transfer(curve) == curve
        assert curve != str(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("a.cube", "LUT_1D_SIZE 3\n0 0 0\n1 1 1\n", "as many rows as its size"),
        ("a.cube", "LUT_1D_SIZE 2\n0 0 0\n1 1 .5\n", "one curve for all channels"),
        ("a.cube", "hello\n", "expected a .cube file"),
        ("a.csv", "0,0\n1,1\n2,.5\n", "expected a curve that rises"),
        ("a.csv", "0,0\nx,1\n", "expected lines"),
    ],
)
def test_a_file_without_a_curve_is_refused(tmp_path, name, text, says):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=says):
        checked_transfer(str(tmp_path / name))


@pytest.mark.parametrize("name", ["gamma", "srgb+gamma", "", "absent.cube"])
def test_an_unknown_transfer_is_refused(name):
    with pytest.raises(InputError, match=r"transfer: expected one of|cannot be read"):
        checked_transfer(name)
