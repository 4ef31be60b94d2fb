"""The methods that DEM is compared with: each takes what ``mavdem.learn`` takes and returns a ``Forecaster``."""

from mavdem.baselines.autoregression import arx
from mavdem.baselines.expectation_maximization import em
from mavdem.baselines.identified import Identified
from mavdem.baselines.joint_autoregression import JointAutoregression, var
from mavdem.baselines.prediction_error_method import pem
from mavdem.baselines.subspace_identification import subspace
from mavdem.baselines.trivial import constant_mean, hold, zero
from mavdem.dem.engine.state_space import StateSpace

__all__ = [
    "Identified",
    "JointAutoregression",
    "StateSpace",
    "arx",
    "constant_mean",
    "em",
    "hold",
    "pem",
    "subspace",
    "var",
    "zero",
]
