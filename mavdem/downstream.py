"""Downstream: methods of ``Flight`` and ``Learned`` whose work is done further down the flow, found when called.

The data know nothing of plots, tables and reports, which know the data. So these methods name the module that does the
work, and import it when they are called, as pandas finds its plotting backend.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from mavdem.extras import require


def downstream(module: str, name: str) -> Any:
    """What ``mavdem.<module>`` calls ``name``."""
    return getattr(import_module(f"mavdem.{module}"), name)


class FlightDownstream:
    """What becomes of a :class:`mavdem.Flight`."""

    def to_pandas(self) -> Any:
        """A ``pandas.DataFrame``: a row a sample, by time in s; columns named with their units as in ``flight.csv``.

        Raises:
            ImportError: pandas is not installed.
        """
        require("Flight.to_pandas()", "pandas")
        return downstream("export.frames", "to_pandas")(self)

    def to_xarray(self) -> Any:
        """An ``xarray.Dataset``: inputs and outputs by time in s and name, their units beside them.

        Raises:
            ImportError: xarray is not installed.
        """
        require("Flight.to_xarray()", "xarray")
        return downstream("export.frames", "to_xarray")(self)

    def _repr_html_(self) -> str:
        return str(downstream("report.html", "flight_html")(self))


class LearnedDownstream:
    """What becomes of a :class:`mavdem.Learned`."""

    @property
    def plot(self) -> Any:
        """Its pictures: ``plot.bode()`` and others return a ``matplotlib.figure.Figure``; see ``mavdem.report.figures.Plots``.

        Raises:
            ImportError: matplotlib is not installed.
        """
        require("Learned.plot", "plot")
        return downstream("report.figures", "Plots")(self)

    def summary(self) -> str:
        """What the vehicle does in wind, on one screen; without windows that the model has not seen.

        ``mavdem.evaluate.held_out_windows`` forecasts such windows.
        """
        return str(downstream("report.screen", "summary")(self))

    def to_control(self) -> Any:
        """The model as a ``control.StateSpace``, about its trim; states, inputs and outputs have their names.

        Raises:
            ImportError: control is not installed.
        """
        require("Learned.to_control()", "control")
        return downstream("export.control_systems", "to_control")(self)

    def _repr_html_(self) -> str:
        return str(downstream("report.html", "learned_html")(self))
