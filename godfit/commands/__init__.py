"""The commands of the command line, a file each.

Nothing here imports JAX before a command runs, so that help and usage errors come at once.
"""

import time

STARTED = time.perf_counter()
"""Time at which the program started, before the other imports, which the user waits for as well."""
