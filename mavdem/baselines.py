"""The public names of the methods that DEM is compared with, ``mavdem.baselines``."""

from mavdem.experiments.methods import (
    ClosedLoop,
    Identified,
    JointAutoregression,
    StateSpace,
    closed_loop,
    constant_mean,
    em,
    hold,
    pem,
    subspace,
    var,
    zero,
)

__all__ = [
    "ClosedLoop",
    "Identified",
    "JointAutoregression",
    "StateSpace",
    "closed_loop",
    "constant_mean",
    "em",
    "hold",
    "pem",
    "subspace",
    "var",
    "zero",
]
