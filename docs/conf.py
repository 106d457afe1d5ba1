"""Sphinx: ``sphinx-build -W docs build/docs``, after ``pip install -e '.[docs]'``."""

import os
import sys
from importlib import metadata
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
os.environ.setdefault("JAX_PLATFORMS", "cpu")

project = "godfit"
author = copyright = "The godfit authors"
release = metadata.version("godfit")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_click"]
exclude_patterns = ["examples"]
html_theme = "pydata_sphinx_theme"
html_theme_options = {"show_prev_next": False, "navigation_depth": 2}
html_sidebars = {"**": ["sidebar-nav-bs"]}
html_show_sourcelink = False
myst_heading_anchors = 3
# A single pair of backticks in a docstring is code.
default_role = "code"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
# Types stand as they are written: whole ones of JAX fill half a page.
autodoc_preserve_defaults = True


def setup(app):
    """Draw the figures of the concepts, and fit the gallery, before pages are read."""
    import figures
    import gallery

    app.connect("builder-inited", lambda app: figures.draw_all(HERE / "_figures"))
    app.connect("builder-inited", lambda app: gallery.fit_all(HERE / "_gallery"))
