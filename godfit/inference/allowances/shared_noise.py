"""What noise that several values share does to the errors of a fit.

The likelihood takes values to be independent. All values of a column whose coordinates drift are
displaced by one draw, and so are those of a row (``arithmetic.py``). A displacement d of a value
with derivatives J by the coordinates and curvature k of its log-likelihood pulls the fit by J k d.
The pulls of a column add up before they are squared:

    sum over columns of (sum J k s)(sum J k s)^T - sum (J k s)(J k s)^T

where s is the standard deviation of the shared noise at each value. The second sum is in the
curvature already. This is a sandwich by clusters (Liang & Zeger, Biometrika 73 (1986), 13) whose
middle is computed from what is known of the noise. It is not estimated from scores: where rounding
hides most values, the few that lie near an end of their interval are too few for that.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from godfit.inference.observation import Observation


def shared_slopes(
    jacobian: Float[np.ndarray, "p m"],
    pull: Float[np.ndarray, " m"],
    observation: Observation,
) -> Float[np.ndarray, "p p"]:
    """Covariance of the log-likelihood's slope by the coordinates, between different values, by the
    observation's shared noise. ``jacobian`` has the derivatives of the levels, ``pull`` the
    curvature of each value's log-likelihood by its level, in 1/levels^2."""
    assert observation.shared_noise is not None
    # Values amid their intervals have no curvature.
    values = np.flatnonzero(pull > 0)
    pixel = np.asarray(observation.pixels)[values // observation.channels]
    column, row = pixel % observation.size[1], pixel // observation.size[1]
    slopes = np.asarray(jacobian[:, values], np.float64) * pull[values]
    total = np.zeros((len(slopes), len(slopes)))
    for i, noise in enumerate(observation.shared_noise):
        pulled = slopes * noise[values]
        sums = np.stack([np.bincount(column if i % 2 == 0 else row, one) for one in pulled])
        total += sums @ sums.T - pulled @ pulled.T
    return total
