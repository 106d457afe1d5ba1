"""A figure that shows itself: in a notebook, and elsewhere in the viewer of pictures."""

from __future__ import annotations

import io

from matplotlib.figure import Figure
from PIL import Image


class ShownFigure(Figure):
    """A figure without pyplot, which would open a window system. A notebook displays it where it is
    the value of a cell; ``show`` opens it anywhere else."""

    def _repr_png_(self) -> bytes:
        data = io.BytesIO()
        self.savefig(data, format="png")
        return data.getvalue()

    def show(self, warn: bool = True) -> None:
        """Open the figure in the system's viewer of pictures."""
        Image.open(io.BytesIO(self._repr_png_())).show()
