"""Folders of files that tests and experiments need."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA_SYNTHETIC = ROOT / "data_synthetic"
SHARED = ROOT.parent / "shared"
"""Meshes and captured pictures that are not part of the repository; tests skip without them."""
