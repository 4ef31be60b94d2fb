"""The methods that DEM is compared with: each takes what ``mavdem.learn`` takes and returns a ``Forecaster``."""

from mavdem.dem.engine.state_space import StateSpace
from mavdem.experiments.methods.identified import Identified
from mavdem.experiments.methods.joint_var import JointAutoregression, var
from mavdem.experiments.methods.maximum_likelihood import em, pem
from mavdem.experiments.methods.plant_in_loop import ClosedLoop, closed_loop
from mavdem.experiments.methods.subspace_identification import subspace
from mavdem.experiments.methods.trivial import constant_mean, hold, zero

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
