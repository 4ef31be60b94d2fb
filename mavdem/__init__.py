"""mavdem: what a multirotor really does in wind, learnt from its flights by Dynamic Expectation Maximization."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mavdem import baselines as baselines
    from mavdem import evaluate as evaluate
    from mavdem.alignment import read_flight as read_flight
    from mavdem.alignment import read_segments as read_segments
    from mavdem.analysis import VehicleFigures as VehicleFigures
    from mavdem.analysis import vehicle as vehicle
    from mavdem.condition import HoverFigures as HoverFigures
    from mavdem.condition import hover as hover
    from mavdem.condition import hover_figures as hover_figures
    from mavdem.dem import Learned as Learned
    from mavdem.dem import OnlineLearner as OnlineLearner
    from mavdem.dem import Settings as Settings
    from mavdem.dem import learn as learn
    from mavdem.dem import learn_many as learn_many
    from mavdem.errors import NotLearnable as NotLearnable
    from mavdem.errors import Unreadable as Unreadable
    from mavdem.flight import Flight as Flight
    from mavdem.forecaster import Forecaster as Forecaster
    from mavdem.ingest import Telemetry as Telemetry

_ROOMS = {
    "alignment": ("read_flight", "read_segments"),
    "analysis": ("VehicleFigures", "vehicle"),
    "condition": ("HoverFigures", "hover", "hover_figures"),
    "dem": ("Learned", "OnlineLearner", "Settings", "learn", "learn_many"),
    "errors": ("NotLearnable", "Unreadable"),
    "flight": ("Flight",),
    "forecaster": ("Forecaster",),
    "ingest": ("Telemetry",),
}
_HOMES = {name: room for room, names in _ROOMS.items() for name in names}
__all__ = sorted([*_HOMES, "baselines", "evaluate"])


def __getattr__(name: str) -> Any:
    # Imported when asked for (PEP 562): scipy takes most of a second, which `mavdem --help` need not wait.
    if name in ("baselines", "evaluate"):
        return import_module(f"mavdem.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"mavdem.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *__all__})
