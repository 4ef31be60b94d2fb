"""Dynamic Expectation Maximization of linear models: arrays in, a learnt model out."""

from mavdem.dem.batch import learn_many
from mavdem.dem.gaussian import Gaussian
from mavdem.dem.learn import learn
from mavdem.dem.learned import Learned
from mavdem.dem.model import LinearModel
from mavdem.dem.online import Estimate, OnlineLearner
from mavdem.dem.physical import Physical, physical
from mavdem.dem.settings import Settings
from mavdem.dem.trace import FreeEnergy, Learning

__all__ = [
    "Estimate",
    "FreeEnergy",
    "Gaussian",
    "Learned",
    "Learning",
    "LinearModel",
    "OnlineLearner",
    "Physical",
    "Settings",
    "learn",
    "learn_many",
    "physical",
]
