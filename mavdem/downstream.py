"""Downstream: what flights, models and assessments become in rooms above, by functions that ``mavdem`` installs."""

from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import Any

_upstairs: Any


def install(upstairs: ModuleType) -> None:
    """Sets the module, :mod:`mavdem.api`, whose functions make all this."""
    global _upstairs
    _upstairs = upstairs


class FlightDownstream:
    """What becomes of a :class:`mavdem.Flight`; ImportError is raised where a package is not installed."""

    def to_pandas(self) -> Any:
        """Returns a ``pandas.DataFrame``: a row a sample, by time in s; columns with units as in ``flight.csv``."""
        return _upstairs.to_pandas(self)

    def to_xarray(self) -> Any:
        """Returns an ``xarray.Dataset``: inputs and outputs by time in s and name, their units beside them."""
        return _upstairs.to_xarray(self)

    def _repr_html_(self) -> str:
        return _upstairs.flight_html(self)


class LearnedDownstream:
    """What becomes of a :class:`mavdem.Learned`; ImportError is raised where a package is not installed."""

    @property
    def plot(self) -> Any:
        """Its pictures: ``plot.bode()`` and others return a ``matplotlib`` figure; see ``report.figures.Plots``."""
        return _upstairs.plots(self)

    def summary(self) -> str:
        """Returns what the vehicle does in wind, on one screen; without windows that the model has not seen.

        ``mavdem.evaluate.held_out_windows`` forecasts such windows.
        """
        return _upstairs.summary(self)

    def to_control(self, model: str = "physical") -> Any:
        """Returns the physical plant with its delay, or DEM's own ``model="dem"``, as a ``control.StateSpace``.

        About the trim, with names of inputs and outputs; its ``name`` says which it is. ``.delay``, s, and ``.draws``,
        plants from the posterior, are the physical plant's. ``ValueError`` where there is none, with the reason.
        """
        return _upstairs.to_control(self, model)

    def loop(self, controller: Any = None) -> Any:
        """Returns rate and attitude loop: the plant, and the ``controller`` of the log's parameters unless given.

        >>> loop = learned.loop()
        >>> loop.phase_margin, loop.phase_margin_interval, loop.gain_margin, loop.crossover  # degrees, dB, Hz

        Raises :class:`NotLearnable`: the plant is not identifiable, or the controller is not known.
        """
        return _upstairs.loop(self, controller)

    def _repr_html_(self) -> str:
        return _upstairs.learned_html(self)


class LoopDownstream:
    """What becomes of the control loops of an axis."""

    @property
    def advice(self) -> Any:
        """Gains to set, with what to expect, or why there are none; :func:`mavdem.condition.loop.advice.advise`."""
        return _upstairs.advice(self)


class TwinDownstream:
    """What becomes of a vehicle for simulators."""

    def replayed(self, dt: float, setpoints: Any, torque: Any, seed: int = 0) -> Any:
        """Returns how the simulator flies it, as ``sitl_scenarios.simulation.replayed``; ValueError where it cannot."""
        return _upstairs.replayed(self, dt, setpoints, torque, seed)


class AssessmentDownstream:
    """What becomes of an assessment of a log."""

    def page(self, path: str | PathLike[str]) -> None:
        """Writes its page to ``path``: one HTML file with pictures, to be read without a network."""
        Path(path).write_text(_upstairs.assessment_page(self), "utf-8", "replace")

    def as_dict(self) -> dict[str, Any]:
        """Returns the document of ``mavdem review --json``, plain JSON values."""
        return _upstairs.assessment_document(self)

    def __str__(self) -> str:
        return _upstairs.assessment_screen(self)
