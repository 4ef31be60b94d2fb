"""Plots: the pictures of one learnt model, as methods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mavdem.condition.hover import HoverFigures
from mavdem.dem import Learned
from mavdem.evaluate.held_out import HeldOut, held_out_test, held_out_windows
from mavdem.flight import Flight
from mavdem.plot.complex_plane import poles
from mavdem.plot.forecasts import forecast
from mavdem.plot.iterations import learning
from mavdem.plot.motor_balance import motors
from mavdem.plot.one_step_errors import residuals
from mavdem.plot.responses import bode, step
from mavdem.plot.style import sample_times
from mavdem.plot.torque import disturbance
from mavdem.report.names import Labels

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Plots:
    """The pictures of a learnt model; each method returns a ``matplotlib.figure.Figure``.

    Notebooks show them, and ``savefig`` writes them: as PNG or, with text that stays text, as SVG.

    Attributes:
        learned: the model with its training data.
    """

    learned: Learned

    def __repr__(self) -> str:
        return (
            "<Plots: forecast(), residuals(), bode(), step(), poles(), disturbance(), motors() and learning() "
            f"of {self.learned!r}>"
        )

    def forecast(self, held_out: Flight | HeldOut | None = None, output: int = 0) -> Figure:
        """An output beside forecasts of samples that no model saw, and the error of every window.

        Args:
            held_out: the flight right after the training data, as one window; or the windows of
                ``mavdem.evaluate.held_out_windows``; those of the training data, for which five models are trained,
                unless given.
            output: which, in the order of the flight's outputs.
        """
        labels, flights = Labels.of(self.learned), self._flights()
        if held_out is None:
            held_out = held_out_windows(flights, self.learned.settings)
        elif isinstance(held_out, Flight):
            held_out = held_out_test(flights[-1], held_out, self.learned)
        return forecast(held_out, labels, range(len(labels.output_names))[output])

    def residuals(self, output: int = -1) -> Figure:
        """One-step errors of an ``output`` over time, with their autocorrelation and correlation with the command."""
        return residuals(self.learned, output)

    def bode(self, output: int = -1, truth: tuple[Array, Array, float] | None = None) -> Figure:
        """Magnitude and phase from the axis's command to an ``output``, with 90 % bands.

        ``truth`` is A (n, n), B (n, r) and the delay, s, of a simulated vehicle.
        """
        return bode(self.learned, output, truth)

    def step(self, truth: tuple[Array, Array, float] | None = None) -> Figure:
        """The outputs after a step of the axis's command, with 90 % bands; ``truth`` as for :meth:`bode`."""
        return step(self.learned, truth)

    def poles(self, truth: Array | None = None) -> Figure:
        """The poles of the model with their regions; ``truth`` is A (n, n) of a simulated vehicle."""
        return poles(self.learned, truth)

    def disturbance(self, truth: Array | None = None) -> Figure:
        """The wind's torque with gusts, and its spectrum; ``truth`` (T,) is that of a simulated flight, rad/s².

        Raises:
            ValueError: no physical parameters can be fitted.
        """
        return disturbance(self.learned, truth)

    def motors(self, hover: HoverFigures | None = None) -> Figure:
        """The effect of each motor with its interval and, with ``hover``, how hard it works.

        ``hover`` is what ``mavdem.hover(log)`` or ``mavdem.hover_figures([flight])`` returned.

        Raises:
            ValueError: no physical parameters can be fitted, and ``hover`` is not given.
        """
        return motors(self.learned, hover)

    def learning(self) -> Figure:
        """F̄, its terms and the parameters by iteration."""
        return learning(self.learned)

    def _flights(self) -> list[Flight]:
        """The training data, a flight a segment."""
        record, labels = self.learned.record, Labels.of(self.learned)
        time = np.split(sample_times(record), record.starts[1:])
        return [
            Flight(own, *both, record.dt, *labels, effect_directions=record.effect_directions)
            for own, both in zip(time, record.segments, strict=True)
        ]
