"""Memory that this process may still take, compared with what a piece of work needs.

Native code that cannot allocate ends the process (LLVM, XLA) or raises what no caller expects. So
large work is compared with the memory before it begins.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from godfit.errors import InputError

GIB = 1 << 30
PROGRAM_BYTES = 9 << 27
"""Address space that JAX and LLVM take for a small fit that compiles all its programs, in bytes; a
third of it is memory. A limit (``ulimit -v``) below this ends the process in native code."""
THREAD_BYTES = 32 << 20
"""Address space that a core's threads take, in bytes: three stacks of 8 MiB, and what they hold."""
FIT_BYTES = 110
"""Memory that a fit takes a pixel, in bytes: the difference between 1920x1080 and 512x512 pixels
(docs/measured.md)."""
UNLIMITED = 1 << 60
"""A cgroup's limit from which it counts as none, in bytes."""
CGROUP_FILES = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)
"""Files of the limit and the use of memory of this process's group, versions 2 and 1."""


def check_memory(need: int, what: str = "") -> None:
    """Raise InputError where ``what`` needs more bytes than this process may still take."""
    has = available_memory()
    if has is not None and need > has:
        begin = f"{what}: " if what else ""
        raise InputError(
            f"{begin}out of memory: needs about {_size(need)}, has {_size(has)}; "
            "give smaller images, or free some"
        )


def check_program_memory() -> None:
    """Raise InputError where a limit on address space leaves too little for any fit."""
    has = _address_space()
    need = PROGRAM_BYTES + THREAD_BYTES * (os.cpu_count() or 1)
    if has is not None and need > has:
        raise InputError(
            f"out of memory: needs about {_size(need)} of address space, has {_size(has)}; "
            "raise the limit (ulimit -v)"
        )


def available_memory() -> int | None:
    """Bytes that this process may still take: the least of the machine's free memory, its limit on
    address space, and that of its control group. None where the system has no such numbers."""
    free = list(_free())
    found = [sum(free), *_group()] if free else list(_group())
    space = _address_space()
    return min([*found, *([] if space is None else [space])], default=None)


def resident_memory() -> int | None:
    """Bytes of memory that this process holds; None where the system does not say."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * resource.getpagesize()
    except (ImportError, OSError, ValueError):
        return None


def _address_space() -> int | None:
    """Bytes of address space left under a limit (RLIMIT_AS); None without one."""
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit == resource.RLIM_INFINITY:
            return None
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        return max(0, limit - pages * resource.getpagesize())
    except (ImportError, OSError, ValueError):
        return None


def _free() -> Iterator[int]:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith(("MemAvailable:", "SwapFree:")):
                yield int(line.split()[1]) << 10
    except (OSError, ValueError, IndexError):
        return


def _group() -> Iterator[int]:
    for limit, used in CGROUP_FILES:
        try:
            most = int(Path(limit).read_text())
            if most < UNLIMITED:
                # Pages of files count as used, and are given up where memory is short.
                yield max(0, most - int(Path(used).read_text()) + _file_pages(used))
        except (OSError, ValueError):
            continue


def _file_pages(used: str) -> int:
    for line in (Path(used).parent / "memory.stat").read_text().splitlines():
        if line.startswith(("inactive_file ", "total_inactive_file ")):
            return int(line.split()[1])
    return 0


def _size(count: int) -> str:
    return f"{count / GIB:.2g} GiB" if count < 100 * GIB else f"{count / GIB:,.0f} GiB"
