"""The methods that DEM is compared with: each takes what ``mavdem.learn`` takes and answers a ``Forecaster``."""

from mavdem.baselines.arx import arx
from mavdem.baselines.em import em
from mavdem.baselines.identified import Identified
from mavdem.baselines.pem import pem
from mavdem.baselines.state_space import StateSpace
from mavdem.baselines.subspace import subspace
from mavdem.baselines.trivial import constant_mean, hold, zero

__all__ = [
    "Identified",
    "StateSpace",
    "arx",
    "constant_mean",
    "em",
    "hold",
    "pem",
    "subspace",
    "zero",
]
