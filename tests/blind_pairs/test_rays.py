"""The misfit along rays, against slow versions that are obviously right."""

import math

import numpy as np
import pytest
from scipy import optimize

from godfit.blind.mask_kernel import decide
from godfit.blind.ray_kernel import kernel_weights, solve_rays
from godfit.blind.rays import Candidate, RayMisfit

AT = Candidate(0.45, 0.55, 2.5, 0.8, 0.02, 12.0, 300.0, 0.06)


def picture(at: Candidate, h: int = 60, w: int = 90) -> np.ndarray:
    """(h, w) the light pass in levels of a disc before a dim background with a dark square, by the
    integral along each ray."""
    rows, columns = np.mgrid[:h, :w]
    x, y = (columns + 0.5) / w, (h - rows - 0.5) / w
    light = np.array([at.u, at.v * h / w])

    def mask(a, b):
        level = np.where(np.hypot(a - light[0], b - light[1]) < at.radius, at.bright, at.dim)
        return np.where((abs(a - 0.65) < 0.06) & (abs(b - 0.3) < 0.06), 0.0, level)

    shares = (np.arange(400) + 0.5) / 400
    weight = np.exp(-at.kappa * shares)
    out = at.own * mask(x, y)
    for share, c in zip(shares * at.rho, weight / 400, strict=True):
        out = out + c * mask(x + share * (light[0] - x), y + share * (light[1] - y))
    return out / (weight.mean() + at.own)


def test_weights_are_those_of_an_integral():
    """A light pass of a ramp along one ray, by quadrature and as the sum over bins."""
    step, bins = 0.02, 120
    weights, inner = kernel_weights(AT.kappa, AT.rho, AT.own, step, bins)
    assert inner[0] == pytest.approx(1)
    # The sum over bins of r' / r = exp(-t) is the mean over the ray of the share of the way left.
    shares = (np.arange(20_000) + 0.5) / 20_000
    taps = np.exp(-AT.kappa * shares)
    whole = (taps * (1 - AT.rho * shares)).mean() + AT.own
    whole /= taps.mean() + AT.own
    assert weights @ np.exp(-step * np.arange(len(weights))) == pytest.approx(whole, rel=2e-3)
    assert len(weights) < bins
    assert -math.log(1 - AT.rho) / step == pytest.approx(len(weights), abs=2)


def test_rays_are_solved_as_by_scipy():
    rng = np.random.default_rng(0)
    bins = 30
    weights, inner = kernel_weights(AT.kappa, AT.rho, AT.own, 0.1, bins)
    full = np.concatenate([weights, np.zeros(bins)])
    lag = np.subtract.outer(np.arange(bins), np.arange(bins))
    design = np.where(lag >= 0, full[np.maximum(lag, 0)], 0.0)
    design[:, 0] = inner
    light = rng.uniform(0, 100, (3, bins))
    weight = rng.uniform(0.5, 1, (3, bins))
    upper = np.full(bins, 80.0)
    x = np.zeros((3, bins))
    residual = solve_rays(light, weight, design, np.stack([upper, np.zeros(bins)]), x, 200)
    for a in range(3):
        root = np.sqrt(weight[a])
        best = optimize.lsq_linear(design * root[:, None], light[a] * root, (0, upper), tol=1e-12)
        assert (weight[a] * residual[a] ** 2).sum() / 2 == pytest.approx(best.cost, rel=1e-4)
        np.testing.assert_allclose(residual[a], light[a] - design @ x[a], atol=1e-9)


def test_slopes_are_finite_differences():
    image = picture(AT)
    misfit = RayMisfit(image, np.ones_like(image), 24, 0.1)
    at = AT._replace(kappa=2.7, rho=0.77, own=0.025, dim=11.0, bright=280.0, radius=0.062)
    x = np.full((24, len(misfit.radii)), at.dim)
    slope = misfit(at, x, 400).slope
    assert slope is not None
    for i, by in ((2, 1e-3), (3, 1e-3), (4, 1e-4), (5, 1e-2), (6, 0.3), (7, 1e-5)):
        ends = []
        for sign in (-1, 1):
            numbers = list(at)
            numbers[i] += sign * by
            ends.append(misfit(Candidate(*numbers), x.copy(), 400, False).cost)
        scale = at[i] if i >= 6 else 1.0
        assert (ends[1] - ends[0]) / (2 * by) * scale == pytest.approx(slope[i], rel=0.03, abs=1e-4)


def test_the_true_numbers_leave_the_least():
    image = picture(AT)
    misfit = RayMisfit(image, np.ones_like(image), 40, 0.08)

    def cost(at: Candidate) -> float:
        x = np.full((40, len(misfit.radii)), at.dim)
        return misfit(at, x, 30, False).cost

    least = cost(AT)
    for changed in ({"u": 0.47}, {"v": 0.52}, {"kappa": 3.5}, {"rho": 0.7}, {"radius": 0.05}):
        assert cost(AT._replace(**changed)) > least + 0.005, changed


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
