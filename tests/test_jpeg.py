"""Fits to JPEGs: the compression is recognised, and what it does to an answer is taken away."""

import io
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import godfit
from godfit.jpeg import compressed, settings_of

sys.path.insert(0, str(Path(__file__).parents[1] / "experiments"))
import scenes
import stability_judges as stability

SIZE = 128


def coloured(seed):
    """Levels (SIZE, SIZE, 3) of soft colours behind hard edges."""
    rng = np.random.default_rng(seed)
    mask = scenes.triangles(rng, SIZE, np.array([0.4, 0.6]))[..., None]
    soft = scenes.clouds(rng, SIZE, np.array([0.6, 0.4]))[..., None]
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


@pytest.mark.usefixtures("single_precision")
def test_the_answer_is_freed_of_what_compression_did():
    """A small run of experiments/recovery.py --made jpeg."""
    inside, shrunk, largest = 0, [], 0.0
    for seed, quality in ((4, 80), (7, 70)):
        mask = stability.mask_of(SIZE, seed=seed)
        exact = scenes.to_bytes(stability.light_pass(mask)).astype(float)
        target = compressed(exact[..., None], quality, 0)[..., 0].astype(np.uint8)
        result = stability.fit(target, mask)
        assert result.converged, result.message
        assert any("JPEG" in w for w in result.warnings)
        assert result.pixels_effective < 0.5 * result.pixels
        naive = stability.fit(target, mask, inquire=False)
        for name, e in result.params.items():
            assert e.stderr is not None
            off = abs(e.value - stability.TRUTH[name])
            inside += off < 2 * e.stderr
            largest = max(largest, off / e.stderr)
            shrunk.append(off / abs(naive.params[name].value - stability.TRUTH[name]))
    # Of 12 intervals of two standard errors, fewer than 9 hold once in 1,000 runs.
    assert inside >= 9
    assert largest < 5
    assert np.median(shrunk) < 0.5


@pytest.mark.usefixtures("single_precision")
def test_a_wrong_model_is_not_excused_by_compression():
    mask = stability.mask_of(SIZE, seed=3)
    shifted = np.roll(mask, (3, -2), (0, 1))
    exact = scenes.to_bytes(stability.light_pass(mask)).astype(float)
    target = compressed(exact[..., None], 75, 0)[..., 0].astype(np.uint8)
    result = godfit.fit(target, mask=shifted, shader="dawntime", samples=stability.SAMPLES)
    assert not result.converged
