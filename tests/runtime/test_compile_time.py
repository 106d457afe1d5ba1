"""Seconds of compilation, where several threads compile at once."""

import threading
import time

import jax.monitoring
import pytest

from godfit.runtime.compile_time import BACKEND_COMPILE_EVENT, beside_others, compile_seconds


def _compiled(seconds: float) -> None:
    jax.monitoring.record_event_duration_secs(BACKEND_COMPILE_EVENT, seconds)


def test_what_threads_compile_at_once_counts_once():
    began = time.perf_counter()
    time.sleep(0.2)
    threads = [threading.Thread(target=_compiled, args=(0.1,)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert compile_seconds(began) == pytest.approx(0.1, abs=0.05)
    # One that went on meanwhile, and longer.
    _compiled(0.15)
    assert compile_seconds(began) == pytest.approx(0.15, abs=0.05)


def test_only_what_came_after_counts():
    time.sleep(0.1)
    began = time.perf_counter()
    time.sleep(0.02)
    _compiled(0.1)
    assert 0.02 <= compile_seconds(began) <= time.perf_counter() - began
    assert compile_seconds(time.perf_counter()) == 0


def test_what_is_compiled_beside_others_takes_no_time():
    began = time.perf_counter()
    with beside_others():
        _compiled(0.1)
    assert compile_seconds(began) == 0
