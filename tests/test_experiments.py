"""What the experiments compare with computes the same sum, and what they measure does its work."""

import importlib.util

import numpy as np
import pytest

from godfit.scattering import radial
from tests.support import peer_fits, plane_measures, random_targets, roofline
from tests.support.synthetic import canvases

SAMPLES = 20


@pytest.fixture
def mask():
    return (np.random.default_rng(3).random((13, 17)) > 0.5).astype(float)


@pytest.fixture
def expected(mask):
    return np.asarray(peer_fits.godfit_forward(mask, SAMPLES, "reference")(peer_fits.TRUTH))


@pytest.mark.parametrize("forward", [peer_fits.scipy_forward, peer_fits.numba_forward])
def test_peers_in_float64(forward, mask, expected):
    np.testing.assert_allclose(forward(mask, SAMPLES)(peer_fits.TRUTH), expected, atol=1e-14)


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="torch is not installed")
@pytest.mark.parametrize("chunk", [1, 7, 50])
def test_torch(mask, expected, chunk):
    import torch

    found = peer_fits.torch_forward(mask, SAMPLES, chunk)(torch.tensor(peer_fits.TRUTH).float())
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-6)


def test_watch_stops_at_the_first_point_that_is_near_enough():
    watch = peer_fits.Watch(tolerance=1e-3, budget=60.0)
    watch(peer_fits.START)
    assert watch.evaluations == 1
    with pytest.raises(peer_fits.Arrived):
        watch(peer_fits.TRUTH + 1e-3 * peer_fits.UNITS / 2)
    assert watch.error == pytest.approx(5e-4)


def test_least_squares_recovers(mask):
    truth = dict(zip(peer_fits.NAMES, peer_fits.TRUTH, strict=True)) | {"samples": 150}
    target = np.floor(random_targets.render64(mask, truth) * 255 + 0.5).astype(np.uint8)
    problem = peer_fits.Problem(mask, target, 150)
    forward = peer_fits.numba_forward(mask, 150)
    # The start is .107 off.
    run = peer_fits.timed(lambda watch: peer_fits.least_squares(forward, problem, watch), 0.02, 20)
    assert run.arrived
    assert run.evaluations > 1


def test_cores_are_shared_out():
    assert roofline.shares([0, 1, 2], 2) == [[0, 2], [1]]
    assert roofline.shares([4, 5], 3) == [[4], [5], [4]]


def test_measured_kernels():
    source, target = np.arange(6, dtype=np.float32).reshape(2, 3), np.zeros((2, 3), np.float32)
    roofline.copy(source, target, 2)
    np.testing.assert_array_equal(target, source)
    values = np.full((2, 64), 3, np.float32)
    roofline.multiply_add(values, 5)
    np.testing.assert_allclose(values, 1 + 2 * 0.999**5, rtol=1e-6)


def test_exact_methods_are_told(monkeypatch):
    def close(mask, light, taps, at):
        return (1 + 1e-4) * radial.METHODS["reference"](mask, light, taps, at)

    monkeypatch.setitem(radial.METHODS, "close", close)
    monkeypatch.setattr(roofline, "METHODS", ["reference", "close"])
    mask = (np.random.default_rng(3).random((16, 16)) > 0.5).astype(float)
    assert roofline.exact(mask) == ["reference"]


def test_light_in_the_plane_is_measured(monkeypatch):
    """Ways take turns, a time is the median of a way's own, and more rays are nearer to the
    reference."""
    seconds = iter([1.0, 2.0, 9.0, 4.0, 5.0, 16.0])
    monkeypatch.setattr(plane_measures, "timed", lambda program: next(seconds))
    values = canvases.stroke(24, 24)
    exact = plane_measures.reference(values, 256)
    ways = {"few": {"rays": 8}, "many": {"rays": 128}}
    found = plane_measures.measured(values, ways, 3, exact)
    assert [found[way][0] for way in ways] == [5, 4]
    assert 0 < found["many"][1] < 0.5 * found["few"][1] < 0.2


def test_canvases_of_the_flood_are_square_and_not():
    sizes = {plane_measures.shapes(seed)[1].shape for seed in range(10)}
    assert sizes == {(200, 200), (150, 260), (280, 120)}
