"""Every test runs strictly: float64 unless it says otherwise, no silent broadcasting between ranks,
and every annotation in godfit checked at run time (jaxtyping with beartype)."""

import os

os.environ["MPLBACKEND"] = "Agg"

import jax
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

# Before any test module imports godfit: the hook rewrites modules as they are loaded.
install_import_hook("godfit", "beartype.beartype")
