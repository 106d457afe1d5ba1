"""A model at a point, ``z`` (p,), with parameters ``held`` (p,) where not NaN: programs of their
own, each kept. Done one by one, the operations of a single ``moved`` take twenty milliseconds."""

from __future__ import annotations

from godfit.kept import kept


@kept
def model_at(z, held, model):
    """The model there."""
    return model.moved(z, held)


@kept
def coordinates_at(z, held, model):
    """(p,) its coordinates, which are not ``z`` where something is held."""
    return model.moved(z, held).coordinates()


@kept
def predicted(z, held, model, seen):
    """(n c,) levels at the pixels seen, every pixel's channels together."""
    return seen.predict(model.moved(z, held))


@kept
def occlusion_of(model, mask):
    """(h, w) or (h, w, c) what the light pass of ``model`` reads."""
    return model.occlusion(mask)
