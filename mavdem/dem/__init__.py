"""Dynamic Expectation Maximization of linear models: arrays in, a learned model out."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

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


def __getattr__(name: str) -> Any:
    """Imports a public name when it is first used (PEP 562): single modules, such as ``parallel``, need no engine."""
    if name in _MODULES:
        return getattr(import_module(f"mavdem.dem.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
