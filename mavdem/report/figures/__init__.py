"""Figures: the charts of a model drawn by matplotlib, without ``pyplot``; ``learned.plot`` has them as methods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from mavdem.dem import Learned
from mavdem.dem.engine.linalg import Array
from mavdem.evaluate.held_out import HeldOut, held_out_test, held_out_windows
from mavdem.flight import Flight
from mavdem.report import model_charts
from mavdem.report.figures.style import figure_of
from mavdem.report.labels import Labels
from mavdem.report.systems import Truth, plant_of

__all__ = ["Plots"]


@dataclass(frozen=True, eq=False)
class Plots:
    """The figures of the model ``learned``; each method returns a ``matplotlib.figure.Figure``.

    Notebooks show them, and ``savefig`` writes them: as PNG or, with text that stays text, as SVG.
    """

    learned: Learned

    def forecast(self, held_out: Flight | HeldOut | None = None, output: int = 0) -> Figure:
        """Draws an output beside forecasts of samples that no model saw, and the error of every window.

        Args:
            held_out: the flight right after the training data, as one window; or the windows of
                ``mavdem.evaluate.held_out_windows``, for which five models are trained unless given.
            output: which, in the order of the flight's outputs.
        """
        record = self.learned.record
        labels = Labels.of(self.learned)
        times = np.split(model_charts.sample_times(record), record.starts[1:])
        flights = [
            Flight(time, *channels, record.dt, *labels, effect_directions=record.effect_directions)
            for time, channels in zip(times, record.segments, strict=True)
        ]
        if held_out is None:
            held_out = held_out_windows(flights, self.learned.settings)
        elif isinstance(held_out, Flight):
            held_out = held_out_test(flights[-1], held_out, self.learned)
        output = range(len(labels.output_names))[output]
        return figure_of(model_charts.forecast(held_out, labels, output))

    def residuals(self, output: int = -1) -> Figure:
        """Draws one-step residuals over time, their autocorrelation and their correlation with the command.

        Beyond the 99 % bounds lies one in a hundred correlations of white residuals that do not depend on the command.
        The bounds of the second allow for autocorrelation of both (Ljung, System Identification, 2nd ed., sec. 16.6).
        The ``output`` is the last one, a rate, unless given.
        """
        return figure_of(model_charts.residuals(self.learned, output))

    def bode(self, output: int = -1, truth: Truth | None = None, model: str = "physical") -> Figure:
        """Draws magnitude and phase of an ``output`` over frequency, from the axis's command, with 90 % bands.

        Of the physical plant; where it is not identifiable, or as ``model="dem"``, of DEM's model. The
        output is the last one, a rate, unless given; ``truth`` is A (n, n) and B (n, r) of a simulated vehicle, whose
        first states are the outputs, and its delay, s.
        """
        return figure_of(model_charts.bode(self.learned, output, truth, model), note=self._remark)

    def disturbance(self, truth: Array | None = None) -> Figure:
        """Draws the wind torque over time with band and gusts, its spectral density, and the ``truth`` (T,), rad/s².

        Raises:
            ValueError: the wind torque is not identifiable.
        """
        return figure_of(model_charts.disturbance(self.learned, truth))

    @property
    def _remark(self) -> str:
        """What the bands of responses leave out."""
        physical = plant_of(self.learned)
        if physical is None:
            return (
                "Control effectiveness is not identifiable in this flight: these are DEM's bands."
            )
        doubts = (f"{name} {status}" for name, status in physical.status.items())
        return f"Bands: 90 %, of the posterior. Of the plant: {', '.join(doubts)}."
