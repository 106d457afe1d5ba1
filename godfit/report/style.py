"""Matplotlib's own style, whatever the user's settings ask for."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

KEPT = ("backend", "backend_fallback", "interactive")
"""Settings that stay as the user has them: no figure of this package goes through pyplot."""

# The settings belong to the process. Two threads that each restored what they found would leave
# the first one's defaults behind.
_lock = threading.RLock()


@contextmanager
def own_style() -> Iterator[None]:
    """Matplotlib's settings are its defaults inside, and the user's again afterwards.

    A matplotlibrc may ask for LaTeX or for fonts that are not installed, and a figure would then
    fail or have other sizes than its layout. ``matplotlib.rc_context`` is not used, because it
    changes the filters of Python's warnings while it copies.
    """
    import matplotlib

    settings, defaults = matplotlib.rcParams, matplotlib.rcParamsDefault
    with _lock:
        # The dict's own methods: those of the settings validate, and warn of what is deprecated.
        before = dict(dict.items(settings))
        own = {name: value for name, value in dict.items(defaults) if name not in KEPT}
        dict.update(settings, own)
        try:
            yield
        finally:
            dict.update(settings, before)
