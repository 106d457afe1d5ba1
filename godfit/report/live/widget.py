"""The viewer as a widget of a notebook: the same module, with its values in Python."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from godfit.errors import InputError

HERE = Path(__file__).parent


def viewer_widget(data: Mapping[str, Any]) -> Any:
    """A widget of the viewer of ``data``. Its trait ``values`` has the parameters by name; a slider
    that moves changes it, and a change of it moves the sliders.

    Raises InputError where anywidget is not installed.
    """
    try:
        import anywidget
        import traitlets
    except ImportError:
        raise InputError(
            "widget: expected anywidget, which is not installed; pip install 'godfit[notebook]'"
        ) from None

    class Viewer(anywidget.AnyWidget):
        """The live page."""

        _esm = HERE / "viewer.js"
        _css = HERE / "style.css"
        data = traitlets.Dict().tag(sync=True)
        values = traitlets.Dict().tag(sync=True)

    return Viewer(data=dict(data), values={row["name"]: row["value"] for row in data["params"]})
