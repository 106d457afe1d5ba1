"""What is freed goes back to the system."""

import subprocess
import sys

import pytest

# A block of 20 MiB, freed, would raise the size from which blocks are mapped: the next one would
# come from the heap, and stay there under a small block that is kept.
PROGRAM = """
import ctypes
from godfit.runtime.malloc import return_freed_memory

if {little}:
    return_freed_memory()
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.free.argtypes = [ctypes.c_void_p]
MIB = 1 << 20

def block():
    at = libc.malloc(20 * MIB)
    ctypes.memset(at, 1, 20 * MIB)
    return at

def resident():
    line = next(line for line in open("/proc/self/status") if "VmRSS" in line)
    return int(line.split()[1]) / 1024

libc.free(block())
before = resident()
blocks = [block() for _ in range(4)]
kept = libc.malloc(MIB)
for at in blocks:
    libc.free(at)
print(resident() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="of glibc")
def test_large_blocks_are_returned_from_under_small_ones():
    def left(little: bool) -> float:
        program = PROGRAM.format(little=little)
        run = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
        return float(run.stdout)

    assert left(True) < 5
    if left(False) < 5:
        pytest.skip("this C library returns them by itself")
