"""The modules of data_synthetic.

That folder holds a script and its parts, and is no package: this module alone puts it on the path.
"""

from __future__ import annotations

import sys

from tests.support.paths import DATA_SYNTHETIC

sys.path.insert(0, str(DATA_SYNTHETIC))

import bodies
import canvases
import make
import photographs
import screens
import stages
import steering

__all__ = ["bodies", "canvases", "make", "photographs", "screens", "stages", "steering"]
