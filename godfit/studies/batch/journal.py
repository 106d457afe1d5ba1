"""The journal of a run: one SQLite file that one process writes, a commit for every fit.

A commit is whole or absent, whatever is killed. On a local disk the file has a write-ahead log: a
commit then waits for no disk. After a power failure the last few fits may be missing, and are made
again. A write-ahead log needs memory that processes share, which network file systems do not have.
There SQLite's rollback journal is used (sqlite.org/wal.html).
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from godfit.errors import InputError
from godfit.studies.batch.jobs import natural_order
from godfit.studies.batch.worker import CRASHED, FAILED, STATUSES, Outcome

NAME = "journal.sqlite"
"""The journal's file in the folder of a run."""
JOURNAL_VERSION = 1
"""Version of the tables, as SQLite's user_version."""
TABLES = """
create table if not exists frames (
    path text primary key, key text not null);
create table if not exists fits (
    key text primary key, status text not null, seconds real not null, host text not null,
    record text, error text not null, thumbnail blob not null);
create table if not exists shards (number integer not null, count integer not null, unique(number));
"""
LOCAL_DISKS = {
    "ext2", "ext3", "ext4", "xfs", "btrfs", "zfs", "f2fs", "tmpfs", "overlay", "bcachefs", "ramfs",
}  # fmt: skip
"""File systems, by Linux's names, on which processes share memory by a file."""
READERS_WAIT_SECONDS = 5.0
"""Time that a reader waits for the end of a commit, in seconds."""


class Row(NamedTuple):
    """A frame of the run and how its fit ended; ``outcome`` is None while it is to be fitted."""

    path: str
    key: str
    outcome: Outcome | None


class Journal:
    """The journal in the file ``path``; ":memory:" keeps nothing. With ``writes`` no other process
    may write it, and it is made where it does not exist.

    Raises InputError where another process writes it, where it is no journal, and where it cannot
    be written. What was committed stays in all cases.
    """

    def __init__(self, path: str | os.PathLike[str], *, writes: bool = True) -> None:
        self.path = os.fspath(path)
        self.lock = Lock(self.path) if writes and self.path != ":memory:" else None
        try:
            with self._explained():
                self._open(writes)
        except BaseException:
            self.close()
            raise

    def _open(self, writes: bool) -> None:
        self.file: sqlite3.Connection | None = None
        if not writes and not os.path.isfile(self.path):
            raise InputError(f"'{self.path}': expected the journal of a run, got no such file")
        self.file = sqlite3.connect(self.path, timeout=READERS_WAIT_SECONDS)
        (version,) = self.file.execute("pragma user_version").fetchone()
        if version > JOURNAL_VERSION:
            raise InputError(
                f"'{self.path}': expected a journal of version {JOURNAL_VERSION}, got {version}; "
                "it was made by a newer godfit"
            )
        if not writes:
            return
        if self.path != ":memory:":
            wal = on_local_disk(self.path)
            self.file.execute(f"pragma journal_mode = {'wal' if wal else 'delete'}")
            self.file.execute(f"pragma synchronous = {'normal' if wal else 'full'}")
        self.file.executescript(f"{TABLES} pragma user_version = {JOURNAL_VERSION};")

    @property
    def connection(self) -> sqlite3.Connection:
        assert self.file is not None
        return self.file

    def close(self) -> None:
        """Close the file and let other processes write it."""
        if getattr(self, "file", None) is not None:
            # A full disk has been reported where it was met.
            with contextlib.suppress(sqlite3.Error):
                self.connection.close()
            self.file = None
        if self.lock is not None:
            self.lock.release()
            self.lock = None

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def plan(self, frames: Iterable[tuple[str, str]], shard: tuple[int, int] | None = None) -> None:
        """Add frames (path, key). A path that is there already gets its new key."""
        with self._explained(), self.connection:
            self._plan(frames)
            if shard is not None:
                self.connection.execute("insert or replace into shards values (?, ?)", shard)

    def _plan(self, frames: Iterable[tuple[str, str]]) -> None:
        self.connection.executemany(
            "insert or replace into frames values (?, ?)",
            [(stored_name(path), key) for path, key in frames],
        )

    def add(self, key: str, outcome: Outcome, paths: Iterable[str] = ()) -> None:
        """Keep how the fit of ``key`` ended, in place of an earlier outcome, and that it is the
        fit of the frames ``paths``."""
        record = None if outcome.record is None else json.dumps(outcome.record)
        with self._explained(), self.connection:
            self._plan((path, key) for path in paths)
            self.connection.execute(
                "insert or replace into fits values (?, ?, ?, ?, ?, ?, ?)",
                (
                    key, outcome.status, outcome.seconds, outcome.host, record,
                    stored_name(outcome.error), outcome.thumbnail,
                ),
            )  # fmt: skip

    def done(self) -> dict[str, str]:
        """The status of every key that has been fitted."""
        with self._explained():
            return dict(self.connection.execute("select key, status from fits"))

    def failed_paths(self) -> set[str]:
        """Frames whose last fit failed or crashed."""
        query = "select path from frames join fits using (key) where status in (?, ?)"
        with self._explained():
            return {path for (path,) in self.connection.execute(query, (FAILED, CRASHED))}

    def outcome(self, key: str) -> Outcome | None:
        """How the fit of ``key`` ended, None where it has not."""
        query = "select status, record, error, seconds, host, thumbnail from fits where key = ?"
        with self._explained():
            found = self.connection.execute(query, (key,)).fetchone()
        return None if found is None else _outcome(found)

    def rows(self) -> Iterator[Row]:
        """The frames in the natural order of their names, each once."""
        with self._explained():
            frames = self.connection.execute("select path, key from frames").fetchall()
        for path, key in sorted(frames, key=lambda frame: natural_order(frame[0])):
            yield Row(path, key, self.outcome(key))

    def counts(self) -> dict[str, int]:
        """How many frames have each status; "to do" are those without one."""
        query = (
            "select ifnull(status, 'to do'), count(*) from frames left join fits using (key)"
            " group by 1"
        )
        with self._explained():
            found = dict(self.connection.execute(query))
        return {status: found.get(status, 0) for status in (*STATUSES, "to do")}

    def merge(self, other: Journal) -> None:
        """Add the frames and fits of another journal. A fit that converged is not replaced by one
        that did not."""
        rank = "(case status when 'converged' then 0 when 'not converged' then 1 else 2 end)"
        query = f"select *, {rank} from fits"
        with self._explained(), self.connection:
            mine = dict(self.connection.execute(f"select key, {rank} from fits"))
            for *values, place in other.connection.execute(query):
                if place < mine.get(values[0], 3):
                    self.connection.execute(
                        "insert or replace into fits values (?, ?, ?, ?, ?, ?, ?)", values
                    )
            found = other.connection.execute("select path, key from frames")
            self.connection.executemany("insert or ignore into frames values (?, ?)", found)
            shards = other.connection.execute("select number, count from shards")
            self.connection.executemany("insert or ignore into shards values (?, ?)", shards)

    def missing_shards(self) -> list[int]:
        """The numbers of the shards that were not merged, of a run that was made in shards."""
        with self._explained():
            found = dict(self.connection.execute("select number, count from shards"))
        return sorted(set(range(1, max(found.values(), default=0) + 1)) - set(found))

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        """SQLite's errors as one line."""
        try:
            yield
        except sqlite3.OperationalError as error:
            reason, advice = str(error), "what it holds is kept"
            if "full" in reason:
                reason = "No space left on device"
                advice = "free some space and give the same command: what was fitted is kept"
            elif "locked" in reason:
                advice = "another program has it open"
            raise InputError(f"'{self.path}': {reason}; {advice}") from error
        except sqlite3.DatabaseError as error:
            raise InputError(
                f"'{self.path}': expected the journal of a run, got {error}; choose another folder"
            ) from error


class Lock:
    """The one process that may write a journal holds this; it ends with the process.

    Where the file system has no locks, the file itself is the lock, and stays behind if the process
    is killed. Raises InputError where another process holds it.
    """

    def __init__(self, journal: str) -> None:
        self.path = f"{journal}.lock"
        mine = f"{os.getpid()} on {platform.node()}"
        self.descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            self.own_file = not self._locked()
            if self.own_file:
                os.close(self.descriptor)
                self.descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
            os.ftruncate(self.descriptor, 0)
            os.write(self.descriptor, mine.encode())
        except (BlockingIOError, FileExistsError, PermissionError) as error:
            with contextlib.suppress(OSError):
                os.close(self.descriptor)
            who = Path(self.path).read_text(errors="replace") or "?"
            raise InputError(
                f"'{journal}': expected a run that nothing else works on, got one of process "
                f"{who}; wait for it, or choose another folder with -o"
            ) from error

    def _locked(self) -> bool:
        """Whether the file is locked now; False where the file system has no locks. Raises
        BlockingIOError or PermissionError where another process has it."""
        try:
            import fcntl
        except ImportError:
            import msvcrt

            msvcrt.locking(self.descriptor, msvcrt.LK_NBLCK, 1)  # pyright: ignore[reportAttributeAccessIssue]
            return True
        try:
            fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise
        except OSError:
            return False
        return True

    def release(self) -> None:
        """Let another process have it."""
        if self.own_file:
            with contextlib.suppress(OSError):
                os.unlink(self.path)
        with contextlib.suppress(OSError):
            os.close(self.descriptor)


def on_local_disk(path: str) -> bool:
    """Whether a file lies on a disk of this machine; False where that is not known."""
    try:
        mounts = [line.split() for line in Path("/proc/self/mounts").read_text().splitlines()]
    except OSError:
        return False
    place = os.path.realpath(path)
    best, kind = -1, ""
    for _, mounted, found, *_ in mounts:
        # Blanks in names are written as octal numbers.
        folder = mounted.encode().decode("unicode_escape").rstrip("/")
        if (place == folder or place.startswith(f"{folder}/")) and len(folder) >= best:
            best, kind = len(folder), found
    return kind in LOCAL_DISKS


def _outcome(found: Iterable) -> Outcome:
    status, record, error, seconds, host, thumbnail = found
    known = None if record is None else json.loads(record)
    return Outcome(status, known, error, seconds, host, thumbnail)


def stored_name(name: str) -> str:
    """A name that SQLite takes: bytes that are not UTF-8 are escaped."""
    return name.encode(errors="backslashreplace").decode()
