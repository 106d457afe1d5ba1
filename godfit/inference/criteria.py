"""Akaike's and Schwarz's criteria, which compare several models of one picture.

Twice the negative log-likelihood, plus 2 (Akaike) or ln(values) (Schwarz) for every parameter that
the picture determines, the noise among them (Burnham & Anderson, Model Selection and Multimodel
Inference, 2002, ch. 2).
"""

from __future__ import annotations

import math

CLEAR = 10.0
"""Difference in a criterion that leaves the other model little support (Burnham & Anderson 2.6)."""


def aic(log_likelihood: float, parameters: int) -> float:
    """Akaike's criterion; the least is best."""
    return 2 * parameters - 2 * log_likelihood


def bic(log_likelihood: float, parameters: int, values: float | int) -> float:
    """Schwarz's criterion for so many independent ``values``; the least is best."""
    return parameters * math.log(values) - 2 * log_likelihood
