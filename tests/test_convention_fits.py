"""Truths of some conventions, found from bytes; experiments/accuracy/conventions.py has all."""

import pytest

from tests.support import convention_truths


@pytest.mark.parametrize(("shader", "seed"), [("mean", 0), ("reshade", 0), ("godot4", 1)])
def test_a_truth_is_found(shader, seed):
    tried = convention_truths.attempt(shader, seed)
    assert tried.converged, tried.message
    assert tried.found, tried.scores
