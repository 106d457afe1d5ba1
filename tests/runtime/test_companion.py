"""Processes that work beside a command."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from godfit.runtime.companion import Companion
from godfit.runtime.one_core import cores

pytestmark = pytest.mark.skipif(cores() < 2, reason="a companion needs a core of its own")
HERE = "tests.support.companions"


@pytest.fixture(autouse=True)
def on_the_path(monkeypatch):
    """A companion has no current folder on its path."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))


def started(name: str) -> Companion:
    companion = Companion.start(f"{HERE}:{name}")
    assert companion is not None
    return companion


def test_an_answer():
    companion = started("reversed_bytes")
    companion.send(b"abc" * 100_000)
    assert companion.answer() == b"cba" * 100_000


def test_none_from_one_that_fails():
    companion = started("fails")
    companion.send(b"")
    assert companion.answer() is None


def test_none_from_one_that_was_killed():
    companion = started("reversed_bytes")
    companion.process.send_signal(signal.SIGKILL)
    companion.process.wait()
    companion.send(b"abc")
    assert companion.answer() is None


def test_no_more_than_one_core(monkeypatch):
    monkeypatch.setattr("godfit.runtime.companion.cores", lambda: 1)
    assert Companion.start(f"{HERE}:fails") is None


@pytest.mark.skipif(not Path("/proc").exists(), reason="processes are looked up in /proc")
def test_it_ends_with_the_command_that_is_killed():
    program = f"""
import time
from godfit.runtime.companion import Companion
companion = Companion.start("{HERE}:sleeps")
companion.send(b"")
print(companion.process.pid, flush=True)
time.sleep(60)
"""
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as command:
        assert command.stdout is not None
        companion = Path("/proc") / command.stdout.readline().decode().strip()
        assert companion.exists()
        command.kill()
    for _ in range(100):
        if ended(companion):
            return
        time.sleep(0.1)
    pytest.fail("the companion is still there")


def ended(process: Path) -> bool:
    """Whether a process is gone, or only waits to be reaped."""
    try:
        return (process / "stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def test_an_interrupt_is_the_commands_alone():
    companion = started("reversed_bytes")
    assert os.getpgid(companion.process.pid) != os.getpgid(0)
    companion.send(b"ab")
    assert companion.answer() == b"ba"
