"""What is to be seen of a light's disc in a picture that comes with nothing."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from godfit.blind.occluders import lit_by
from godfit.inference.evaluate import model_at
from godfit.inference.observation import Picture
from godfit.models.disc_light import DiscLight

# A disc is in sight where it is brighter than the veil by this.
SEEN = 1.1


def out_of_sight(model: DiscLight, z: np.ndarray, held: np.ndarray, picture: Picture) -> bool:
    """Whether, at coordinates ``z`` (p,), ``held`` (p,) where not NaN, nothing in the picture is
    lit by more than the veil."""
    lit = lit_by(model_at(z, held, model), (picture.mask.shape[0], picture.mask.shape[1]))
    return bool(lit.max() < SEEN * lit.min())


def hidden(model: DiscLight, z: np.ndarray, held: np.ndarray, picture: Picture) -> bool:
    """Whether, at coordinates ``z`` (p,), ``held`` (p,) where not NaN, less than a tenth of the
    light's outline lies where some channel can be read."""
    at = model_at(z, held, model)
    h, w = picture.size
    (u, v), radius = np.asarray(at.light)[0], float(np.asarray(at.shape)[0])
    turn = np.linspace(0, 2 * np.pi, 256, endpoint=False)
    column = np.floor(u * w + radius * h * np.cos(turn)).astype(int)
    row = np.floor((1 - v) * h - radius * h * np.sin(turn)).astype(int)
    inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
    known = ndimage.binary_erosion(picture.readable)
    return bool(np.count_nonzero(known[row[inside], column[inside]]) < 25)
