"""mavdem: what a multirotor really does in wind, learnt from its flights by Dynamic Expectation Maximization."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mavdem.facts import Fact, Words, speak

if TYPE_CHECKING:
    from mavdem import baselines, evaluate
    from mavdem.alignment import read_flight, read_segments
    from mavdem.analysis import VehicleFigures, vehicle
    from mavdem.condition.condition import HoverFigures, hover, hover_figures
    from mavdem.condition.wind_of_log import wind
    from mavdem.condition.wind_velocity import WindVelocity, estimate_wind
    from mavdem.dem import Drag, Learned, OnlineLearner, Settings, estimate_drag, learn, learn_many
    from mavdem.errors import NotLearnable, Unreadable
    from mavdem.flight import Flight
    from mavdem.forecaster import Forecaster
    from mavdem.ingest import Telemetry


def _words(fact: Fact) -> Words:
    # Imported when a fact is first put in words.
    from mavdem.report.words import words

    return words(fact)


speak(_words)

__all__ = [
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
    "VehicleFigures",
    "WindVelocity",
    "baselines",
    "estimate_drag",
    "estimate_wind",
    "evaluate",
    "hover",
    "hover_figures",
    "learn",
    "learn_many",
    "read_flight",
    "read_segments",
    "vehicle",
    "wind",
]
_ROOMS = {
    "alignment": ("read_flight", "read_segments"),
    "analysis": ("VehicleFigures", "vehicle"),
    "condition.condition": (
        "HoverFigures",
        "hover",
        "hover_figures",
    ),
    "condition.wind_of_log": ("wind",),
    "condition.wind_velocity": (
        "WindVelocity",
        "estimate_wind",
    ),
    "dem": ("Drag", "Learned", "OnlineLearner", "Settings", "estimate_drag", "learn", "learn_many"),
    "errors": ("NotLearnable", "Unreadable"),
    "flight": ("Flight",),
    "forecaster": ("Forecaster",),
    "ingest": ("Telemetry",),
}
_HOMES = {name: room for room, names in _ROOMS.items() for name in names}


def __getattr__(name: str) -> Any:
    # Imported when asked for (PEP 562): scipy takes most of a second, which `mavdem --help` need not wait.
    if name in ("baselines", "evaluate"):
        return import_module(f"mavdem.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"mavdem.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *__all__})
