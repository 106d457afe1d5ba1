"""The compression of a JPEG is recognised."""

import io

import numpy as np
import pytest
from PIL import Image
from scipy import fft

from godfit.io.jpeg import DCT, compressed, settings_of
from tests.support import random_targets

SIZE = 128


def coloured(seed):
    """Levels (SIZE, SIZE, 3) of soft colours behind hard edges."""
    rng = np.random.default_rng(seed)
    mask = random_targets.triangles(rng, SIZE, np.array([0.4, 0.6]))[..., None]
    soft = random_targets.clouds(rng, SIZE, np.array([0.6, 0.4]))[..., None]
    return np.floor(60 + 80 * mask * [1.0, 0.8, 0.3] + 90 * soft * [0.2, 0.5, 1.0])


@pytest.mark.parametrize("quality", [60, 75, 90])
def test_quality_and_subsampling_are_told(quality):
    picture = coloured(quality)
    assert settings_of(picture) is None
    assert settings_of(picture[..., :1]) is None
    once = compressed(picture[..., :1], quality, 0)
    assert settings_of(once) == (quality, 0)
    for subsampling in (0, 2):
        once = compressed(picture, quality, subsampling)
        assert settings_of(once) == (quality, subsampling)


def test_other_tables_are_not_taken_for_known_ones():
    table = np.clip(np.arange(64) * 3 + 5, 1, 255).tolist()
    file = io.BytesIO()
    Image.fromarray(coloured(0)[..., 0].astype(np.uint8)).save(file, "JPEG", qtables=[table])
    assert settings_of(np.asarray(Image.open(file), np.float32)[..., None]) is None


def test_the_cosine_transform_is_scipys():
    block = np.random.default_rng(0).random((8, 8))
    expected = np.asarray(fft.dctn(block, norm="ortho"))
    np.testing.assert_allclose(DCT @ block @ DCT.T, expected, atol=1e-14)
