"""Sizes that ``strips`` and its kernel share: the one has no numba, the other no JAX."""

TILE_ROWS = 32
"""Rows of a tile of S alone: with its strips it stays in the cache closest to the core."""
FLAT_CELL = 8
"""Side, in texels, of the cells of which the mask has one value or not."""
