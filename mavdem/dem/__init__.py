"""Dynamic Expectation Maximization of linear models: arrays in, a learned model out."""

from typing import TYPE_CHECKING

from mavdem.lazy_names import lazy_names

if TYPE_CHECKING:
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
_MODULES = {
    "Estimate": "online.estimate",
    "FreeEnergy": "engine.ascent",
    "Gaussian": "settings",
    "Learned": "learned",
    "Learning": "engine.ascent",
    "LinearModel": "engine.model",
    "OnlineLearner": "online.learner",
    "Settings": "settings",
    "learn": "learning",
    "learn_many": "learning",
}
"""Module below ``mavdem.dem`` that defines each public name."""

# Single modules, such as ``parallel``, need no engine.
__getattr__ = lazy_names(__name__, _MODULES)
