"""Dynamic Expectation Maximization of linear models: arrays in, a learned model out."""

from mavdem.dem.engine.ascent import FreeEnergy, Learning
from mavdem.dem.engine.model import LinearModel
from mavdem.dem.learned import Learned
from mavdem.dem.learning import learn, learn_many
from mavdem.dem.online.estimate import Estimate
from mavdem.dem.online.learner import OnlineLearner
from mavdem.dem.settings import Gaussian, Settings

__all__ = [
    "Estimate",
    "FreeEnergy",
    "Gaussian",
    "Learned",
    "Learning",
    "LinearModel",
    "OnlineLearner",
    "Settings",
    "learn",
    "learn_many",
]
