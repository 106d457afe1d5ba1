"""Frames that end their workers, runs that are killed, and clusters of others."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

import godfit
from godfit.__main__ import main
from godfit.errors import InputError
from godfit.studies.batch import engine
from godfit.studies.batch.journal import Journal
from tests.support import batch_work
from tests.support.paths import ROOT

CLIENT = [sys.executable, "-m", "tests.support.batch_work", "batch"]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT), batch_work.SECONDS_VARIABLE: "0.2"}


@pytest.fixture
def frames(tmp_path, monkeypatch):
    """Eight frames in the working folder, and work in place of their fits."""
    for i in range(8):
        (tmp_path / f"f_{i}.png").write_bytes(f"frame {i}".encode())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(engine, "fit_one", batch_work.stand_in)
    return tmp_path


def children() -> list[psutil.Process]:
    """The processes of this one that Python runs, and below them."""
    found = psutil.Process().children(recursive=True)
    return [p for p in found if "resource_tracker" not in " ".join(p.cmdline())]


def table(folder: Path) -> bytes:
    """The table of the run in ``folder`` as it is now."""
    assert main(["batch", "-o", str(folder), "--table", f"{folder}/t.csv", "-q"]) in (0, 1, 3)
    return (folder / "t.csv").read_bytes()


def undisturbed(tmp_path: Path) -> bytes:
    """The table of a run in one process."""
    main(["batch", "f_*.png", "-o", str(tmp_path / "whole"), "--workers", "1", "-q"])
    return table(tmp_path / "whole")


def test_frames_that_end_their_worker_are_named_and_the_others_finish(frames, monkeypatch):
    for name in ("crash.png", "once.png", "raise.png"):
        (frames / name).write_bytes(name.encode())
    fits = list(godfit.batch(["*.png"], output="run", workers=2))
    assert len(fits) == 11
    found = {fit.path: fit for fit in fits}
    assert found["crash.png"].status == "crashed"
    assert "its worker ended" in found["crash.png"].error
    assert found["raise.png"].status == "failed"
    assert "expected a picture" in found["raise.png"].error
    assert found["once.png"].record == batch_work.made_up(b"once.png")
    assert sum(fit.record is not None for fit in fits) == 9
    # What failed is fitted again on request, and nothing else: not what is new either.
    (frames / "raise.png").write_bytes(b"mended")
    (frames / "late.png").write_bytes(b"late")
    monkeypatch.setattr(batch_work, "FATAL", ())
    again = godfit.batch(["*.png"], output="run", workers=1, retry_failed=True)
    assert {fit.path: fit.record for fit in again} == {
        "raise.png": batch_work.made_up(b"mended"), "crash.png": batch_work.made_up(b"crash.png")
    }  # fmt: skip
    with Journal("run/journal.sqlite", writes=False) as journal:
        assert not journal.failed_paths()
        assert sum(journal.counts().values()) == 11


def test_the_iterator_yields_early_and_ends_its_workers(frames, monkeypatch):
    monkeypatch.setenv(batch_work.SECONDS_VARIABLE, "0.3")
    fits = godfit.batch("f_*.png", output="run", workers=2)
    first = next(fits)
    assert first.record is not None
    with Journal("run/journal.sqlite", writes=False) as journal:
        assert 1 <= len(journal.done()) < 8
    workers = children()
    assert len(workers) >= 2
    with pytest.raises(InputError, match="nothing else works on"):
        next(godfit.batch("f_*.png", output="run", workers=1))
    fits.close()
    psutil.wait_procs(workers, timeout=5)
    assert not children()
    # The others are still there to be fitted, and those that were come from the journal.
    rest = list(godfit.batch("f_*.png", output="run", workers=1))
    assert sorted(fit.path for fit in rest) == [f"f_{i}.png" for i in range(8)]


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)]
)
def test_a_client_that_ends_loses_nothing(frames, number, status):
    arguments = ["f_*.png", "-o", "run", "--workers", "2", "--table", "t.csv"]
    client = subprocess.Popen(
        [*CLIENT, *arguments], env=ENVIRONMENT, stderr=subprocess.PIPE, start_new_session=True
    )
    wait_for_fits("run/journal.sqlite", 2)
    workers = psutil.Process(client.pid).children(recursive=True)
    began = time.monotonic()
    # As a terminal does: to all processes of the group.
    if number == signal.SIGINT:
        os.killpg(client.pid, number)
    else:
        client.send_signal(number)
    said = client.communicate(timeout=30)[1].decode()
    assert client.returncode == status
    if status > 0:
        assert time.monotonic() - began < 2
        assert said.startswith("godfit: error: interrupted; ")
        assert "frames are in 'run/journal.sqlite'; the same command goes on\n" in said
        assert said.count("\n") == 1
    assert not psutil.wait_procs(workers, timeout=10)[1]
    with Journal("run/journal.sqlite", writes=False) as journal:
        before = len(journal.done())
    assert 2 <= before < 8
    arguments[arguments.index("2")] = "1"
    assert main(["batch", *arguments, "-q"]) in (0, 3)
    assert Path("t.csv").read_bytes() == undisturbed(frames)


def wait_for_fits(path: str, count: int) -> None:
    """Return when a run has ``count`` fits."""
    for _ in range(600):
        time.sleep(0.05)
        if os.path.exists(path):
            try:
                with Journal(path, writes=False) as journal:
                    if len(journal.done()) >= count:
                        return
            except InputError:
                # The journal has no tables yet.
                continue
    raise TimeoutError(path)


def test_a_cluster_of_others_gives_the_same_table(frames):
    dask = [sys.executable, "-m", "distributed.cli"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": ENVIRONMENT}
    scheduler = [
        "dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
        "--scheduler-file", "scheduler.json",
    ]  # fmt: skip
    worker = [
        "dask_worker", "--scheduler-file", str(frames / "scheduler.json"), "--nthreads", "1",
        "--no-dashboard", "--host", "127.0.0.1",
    ]  # fmt: skip
    (frames / "elsewhere").mkdir()
    started = []
    try:
        for (module, *arguments), folder in ((scheduler, "."), *[(worker, "elsewhere")] * 2):
            command = [*dask[:2], f"{dask[2]}.{module}", *arguments]
            started.append(subprocess.Popen(command, cwd=folder, **quiet))
        wait_for_file(frames / "scheduler.json")
        address = json.loads((frames / "scheduler.json").read_text())["address"]
        for place, folder in (("scheduler.json", "a"), (address, "b")):
            assert main(["batch", "f_*.png", "-o", folder, "--scheduler", place, "-q"]) in (0, 3)
            assert table(frames / folder) == undisturbed(frames)
    finally:
        for process in started:
            process.terminate()
        for process in started:
            process.wait(30)


def wait_for_file(path: Path) -> None:
    for _ in range(600):
        if path.exists():
            return
        time.sleep(0.05)
    raise TimeoutError(path)


@pytest.mark.parametrize("place", ["nothing.json", "tcp://127.0.0.1:1"])
def test_no_scheduler(frames, monkeypatch, place):
    monkeypatch.setattr(engine, "CONNECT_SECONDS", 0.5)
    with pytest.raises(InputError, match="--scheduler: expected"):
        next(godfit.batch("f_*.png", scheduler=place))


def test_workers_that_die_while_they_start_are_started_again():
    tries = []

    def start(**_):
        tries.append(1)
        if len(tries) < engine.START_TRIES:
            raise RuntimeError("Nanny failed to start.")
        return "cluster"

    assert engine._cluster(2, start) == "cluster"
    assert len(tries) == engine.START_TRIES

    def fail(**_):
        raise RuntimeError("Nanny failed to start.")

    with pytest.raises(InputError, match="expected 2 processes to start"):
        engine._cluster(2, fail)
