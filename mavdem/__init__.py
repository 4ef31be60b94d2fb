"""mavdem: what a multirotor really does in wind, learned from its flights by Dynamic Expectation Maximization."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mavdem.lazy_names import lazy_names

if TYPE_CHECKING:
    from mavdem import baselines, evaluate
    from mavdem.assessment import Assessment, review
    from mavdem.dataset.flights import read_flight, read_segments
    from mavdem.dem import Learned, OnlineLearner, Settings, learn, learn_many
    from mavdem.errors import NotLearnable, Unreadable
    from mavdem.flight import Flight
    from mavdem.forecaster import Forecaster
    from mavdem.ingest import Telemetry
    from mavdem.motors.hover import HoverFigures, hover
    from mavdem.wind_velocity.drag_identification import estimate_drag
    from mavdem.wind_velocity.estimation import estimate_wind
    from mavdem.wind_velocity.from_log import wind
    from mavdem.wind_velocity.vehicle_drag import Drag
    from mavdem.wind_velocity.velocity import WindVelocity


__all__ = [
    "Assessment",
    "Drag",
    "Flight",
    "Forecaster",
    "HoverFigures",
    "Learned",
    "NotLearnable",
    "OnlineLearner",
    "Settings",
    "Telemetry",
    "Unreadable",
    "WindVelocity",
    "baselines",
    "estimate_drag",
    "estimate_wind",
    "evaluate",
    "hover",
    "learn",
    "learn_many",
    "read_flight",
    "read_segments",
    "review",
    "wind",
]
_MODULES = {
    "Assessment": "assessment",
    "Drag": "wind_velocity.vehicle_drag",
    "Flight": "flight",
    "Forecaster": "forecaster",
    "HoverFigures": "motors.hover",
    "Learned": "dem",
    "NotLearnable": "errors",
    "OnlineLearner": "dem",
    "Settings": "dem",
    "Telemetry": "ingest",
    "Unreadable": "errors",
    "WindVelocity": "wind_velocity.velocity",
    "estimate_drag": "wind_velocity.drag_identification",
    "estimate_wind": "wind_velocity.estimation",
    "hover": "motors.hover",
    "learn": "dem",
    "learn_many": "dem",
    "read_flight": "dataset.flights",
    "read_segments": "dataset.flights",
    "review": "assessment",
    "wind": "wind_velocity.from_log",
}
"""Module below ``mavdem`` that defines each public name, except the modules ``baselines`` and ``evaluate``."""

_imported_name = lazy_names(__name__, _MODULES)


def __getattr__(name: str) -> Any:
    """Imports a public name when it is first used (PEP 562).

    An eager import would load scipy, which takes most of a second: ``mavdem --help`` need not wait for it. Nor need it
    wait for the library that reads the version.
    """
    if name in ("baselines", "evaluate"):
        return import_module(f"mavdem.{name}")
    if name == "__version__":
        from importlib.metadata import version

        return version("mavdem")
    return _imported_name(name)


def __dir__() -> list[str]:
    """Returns the public names, also those that are not imported yet."""
    return [*__all__, "__version__"]
