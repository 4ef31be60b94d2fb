"""Dynamic Expectation Maximization of linear models: arrays in, a learned model out."""

from mavdem.dem.airflow.identification import estimate_drag
from mavdem.dem.airflow.model import Drag
from mavdem.dem.engine.ascent import FreeEnergy, Learning
from mavdem.dem.engine.model import LinearModel
from mavdem.dem.graybox import NotIdentifiable, Physical, WindTorque, physical
from mavdem.dem.learned import Learned
from mavdem.dem.learning import learn, learn_many
from mavdem.dem.online.learner import OnlineLearner
from mavdem.dem.online.tracker import Estimate
from mavdem.dem.settings import Gaussian, Settings

__all__ = [
    "Drag",
    "Estimate",
    "FreeEnergy",
    "Gaussian",
    "Learned",
    "Learning",
    "LinearModel",
    "NotIdentifiable",
    "OnlineLearner",
    "Physical",
    "Settings",
    "WindTorque",
    "estimate_drag",
    "learn",
    "learn_many",
    "physical",
]
