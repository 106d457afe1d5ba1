"""Seconds of compilation, where several threads compile at once."""

from types import SimpleNamespace

import jax.monitoring
import pytest

from godfit.runtime import compile_time
from godfit.runtime.compile_time import BACKEND_COMPILE_EVENT, beside_others, compile_seconds


@pytest.fixture
def compiled(monkeypatch):
    """compiled(begin, end): something was compiled between these two times."""
    now = SimpleNamespace(perf_counter=lambda: 0.0)
    monkeypatch.setattr(compile_time, "time", now)
    monkeypatch.setattr(compile_time, "_spans", [])

    def tell(begin: float, end: float) -> None:
        now.perf_counter = lambda: end
        jax.monitoring.record_event_duration_secs(BACKEND_COMPILE_EVENT, end - begin)

    return tell


def test_what_threads_compile_at_once_counts_once(compiled):
    for begin, end in ((1.0, 2.0), (1.5, 2.5), (4.0, 5.0), (4.25, 5.0), (7.0, 8.0)):
        compiled(begin, end)
    assert compile_seconds(0.0) == pytest.approx(1.5 + 1 + 1)
    # One that went on all the while, and ends last.
    compiled(0.5, 9.0)
    assert compile_seconds(0.0) == pytest.approx(8.5)


def test_only_what_came_after_counts(compiled):
    compiled(1.0, 2.0)
    compiled(4.0, 6.0)
    assert compile_seconds(5.0) == pytest.approx(1.0)
    assert compile_seconds(6.0) == 0


def test_what_is_compiled_beside_others_takes_no_time(compiled):
    with beside_others():
        compiled(1.0, 2.0)
    assert compile_seconds(0.0) == 0
