"""The methods that DEM is compared with: each takes what ``mavdem.learn`` takes and returns a ``Forecaster``."""

from mavdem.baselines.identified import (
    Identified,
    JointAutoregression,
    constant_mean,
    hold,
    var,
    zero,
)
from mavdem.baselines.maximum_likelihood import em, pem
from mavdem.baselines.subspace_identification import subspace
from mavdem.dem.engine.state_space import StateSpace

__all__ = [
    "Identified",
    "JointAutoregression",
    "StateSpace",
    "constant_mean",
    "em",
    "hold",
    "pem",
    "subspace",
    "var",
    "zero",
]
