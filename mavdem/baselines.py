"""The public names of the methods that DEM is compared with, ``mavdem.baselines``."""

from mavdem.experiments.methods import (
    Identified,
    JointAutoregression,
    StateSpace,
    constant_mean,
    em,
    hold,
    pem,
    subspace,
    var,
    zero,
)

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
