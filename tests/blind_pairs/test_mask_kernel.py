"""Texels of a mask, decided one after the other from the light pass."""

import numpy as np

from godfit.blind.mask_kernel import decide


def test_texels_are_decided_from_the_light_outwards():
    """From the light pass of a mask by a plain loop, that mask."""
    rng = np.random.default_rng(1)
    h, w, place = 20, 26, (11.3, 8.6)
    mask = rng.choice([0.0, 0.1, 1.0], (h, w))
    t, c, own = np.linspace(0.05, 0.85, 12), 0.9 ** np.arange(12.0), 1.5
    light = own * mask
    for i in range(h):
        for j in range(w):
            for share, weight in zip(t, c, strict=True):
                x, y = j + share * (place[0] - j), i + share * (place[1] - i)
                a, b = int(np.floor(x)), int(np.floor(y))
                for row, column in ((b, a), (b, a + 1), (b + 1, a), (b + 1, a + 1)):
                    part = (1 - abs(x - column)) * (1 - abs(y - row))
                    row, column = min(max(row, 0), h - 1), min(max(column, 0), w - 1)
                    light[i, j] += weight * part * mask[row, column]
    rows, columns = np.divmod(np.arange(h * w), w)
    order = np.argsort((columns - place[0]) ** 2 + (rows - place[1]) ** 2)
    found, sure = np.zeros((h, w)), np.ones((h, w), int)
    for _ in range(12):
        total = decide(found, light, sure, order, (place, own, t, c), np.array([1.0]))
    np.testing.assert_allclose(found, mask, atol=0.02)
    np.testing.assert_allclose(total, light, atol=0.05)
    assert (
        decide(found, light, sure, order, (place, own, t, c), np.array([0.0, 0.1, 1.0])) >= 0
    ).all()
    np.testing.assert_array_equal(found, mask)
