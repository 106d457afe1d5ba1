"""Answers of several frames as one: against what made them."""

import numpy as np
import pytest

from godfit.studies.pooling import pooled


def frames(rng, count, widen=1.0):
    """Answers about TRUTH, each with an error of its own kind, and their informations."""
    informations = []
    answers = []
    for _ in range(count):
        root = rng.normal(size=(3, 3)) * [0.1, 1, 10]
        covariance = root.T @ root + np.diag([1e-3, 1e-1, 10.0])
        answers.append(rng.multivariate_normal(TRUTH, widen**2 * covariance))
        informations.append(np.linalg.inv(covariance))
    return np.array(answers), np.array(informations)


TRUTH = np.array([1.0, -2.0, 300.0])


def test_the_mean_is_weighted_by_information():
    """Against least squares on all answers at once, whitened."""
    answers, informations = frames(np.random.default_rng(0), 6)
    pool = pooled(answers, informations)
    roots = [np.linalg.cholesky(i).T for i in informations]
    design, goal = (
        np.vstack(roots),
        np.concatenate([r @ a for r, a in zip(roots, answers, strict=True)]),
    )
    assert pool.agrees.all()
    np.testing.assert_allclose(pool.mean, np.linalg.lstsq(design, goal)[0], rtol=1e-8)
    # Widened by the scatter, and again by the jackknife: never less, and as correlated.
    covariance = np.linalg.inv(design.T @ design)
    wider = np.sqrt(np.diag(pool.covariance) / np.diag(covariance) / pool.growth)
    assert (wider > 1 - 1e-9).all()
    np.testing.assert_allclose(
        pool.covariance / pool.growth, covariance * np.outer(wider, wider), rtol=1e-6
    )


def test_intervals_cover_and_shrink_with_the_root_of_the_number():
    rng = np.random.default_rng(1)
    inside, off = [], []
    for _ in range(300):
        pool = pooled(*frames(rng, 10))
        error = np.sqrt(np.diag(pool.covariance))
        inside.append(np.abs(pool.mean - TRUTH) <= 1.96 * error)
        off.append((pool.mean - TRUTH) / error)
    # The wider of two errors, each of which covers, covers a little more often.
    assert 0.94 <= np.mean(inside) <= 0.995
    assert 0.75 <= np.std(off) <= 1.05


@pytest.mark.parametrize("wrong", [1, 3])
def test_frames_that_are_wrong_are_left_out(wrong):
    rng = np.random.default_rng(2)
    answers, informations = frames(rng, 10)
    answers[:wrong] += [[5, 50, 500]]
    pool = pooled(answers, informations)
    assert list(np.flatnonzero(~pool.agrees)) == list(range(wrong))
    without = pooled(answers[wrong:], informations[wrong:])
    np.testing.assert_allclose(pool.mean, without.mean, rtol=1e-9)


def test_errors_are_widened_by_the_scatter():
    answers, informations = frames(np.random.default_rng(3), 12, widen=1.6)
    pool = pooled(answers, informations)
    assert 1.5 < pool.growth < 4


def test_combinations_that_frames_claim_to_know_too_well_do_not_fool_the_mean():
    """Every frame is off by its single errors, and claims to know a combination a hundred times
    better than it does. Without the jackknife 8% of the intervals hold."""
    rng = np.random.default_rng(6)
    inside = []
    for _ in range(60):
        answers, informations = frames(rng, 10)
        for i in range(10):
            covariance = np.linalg.inv(informations[i])
            answers[i] = TRUTH + rng.normal(size=3) * np.sqrt(np.diag(covariance))
            values, vectors = np.linalg.eigh(covariance)
            values[0] *= 1e-4
            informations[i] = np.linalg.inv((vectors * values) @ vectors.T)
        pool = pooled(answers, informations)
        inside.append(np.abs(pool.mean - TRUTH) <= 1.96 * np.sqrt(np.diag(pool.covariance)))
    assert np.mean(inside) > 0.7


def test_what_no_frame_tells_stays_open():
    answers, informations = frames(np.random.default_rng(4), 4)
    answers[:, 0] = 0.1
    informations[:, 0] = informations[:, :, 0] = 0
    pool = pooled(answers, informations)
    assert pool.mean[0] == 0.1
    assert np.isinf(pool.covariance[0, 0])
    assert np.isfinite(np.diag(pool.covariance)[1:]).all()


def test_one_frame_alone_tells_what_the_others_do_not():
    answers, informations = frames(np.random.default_rng(5), 4)
    informations[1:, 0] = informations[1:, :, 0] = 0
    answers[1:, 0] = 0.1
    pool = pooled(answers, informations)
    assert pool.agrees.all()
    assert abs(pool.mean[0] - answers[0, 0]) < 3 / np.sqrt(informations[0, 0, 0])
