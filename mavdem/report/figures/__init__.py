"""The charts of a learned model as matplotlib figures, which ``learned.plot`` has as methods."""

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from mavdem.dem import Learned
from mavdem.experiments.held_out import HeldOut, held_out_windows
from mavdem.flight import Flight
from mavdem.report.charts import model_charts
from mavdem.report.figures.style import draw_charts
from mavdem.report.labels import Labels

__all__ = ["Plots"]


@dataclass(frozen=True, eq=False)
class Plots:
    """The figures of a model; each method returns a ``matplotlib.figure.Figure``, made without ``pyplot``.

    Notebooks show them, and ``savefig`` writes them: as PNG or, with text that stays text, as SVG.

    Attributes:
        learned: the learned model.
    """

    learned: Learned

    def forecast(self, held_out: HeldOut | None = None, output: int = 0) -> Figure:
        """Draws an output beside forecasts of samples that no model was trained on, and the error of every window.

        Args:
            held_out: the windows of ``mavdem.evaluate.held_out_windows``, for which five models are trained unless
                given.
            output: index in the order of the flight's outputs.

        Returns:
            The figure with both charts.
        """
        if held_out is None:
            held_out = held_out_windows(self._training_flights(), self.learned.settings)
        charts = model_charts.forecast_charts(held_out, Labels.of(self.learned), output)
        return draw_charts(charts)

    def residuals(self, output: int = -1) -> Figure:
        """Draws one-step residuals over time, their autocorrelation and their correlation with the command.

        The residuals of a good model are white and do not depend on the command: one in a hundred of their correlations
        lies beyond the 99 % bounds. The bounds of the correlation with the command allow for the autocorrelation of
        both signals (Ljung, System Identification, 2nd ed., sec. 16.6).

        Args:
            output: index of the output; by default the last one, a rate.

        Returns:
            The figure with the three charts.
        """
        return draw_charts(model_charts.residual_charts(self.learned, output))

    def bode(self, output: int = -1) -> Figure:
        """Draws the Bode diagram of the vehicle: magnitude and phase of an output per command of the axis.

        The response is computed from the physical plant, with 90 % bands, or, where that is not identifiable, from
        DEM's model without bands.

        Args:
            output: index of the output; by default the last one, a rate.

        Returns:
            The figure with both charts.
        """
        return draw_charts(model_charts.bode_charts(self.learned, output))

    def disturbance(self) -> Figure:
        """Draws the wind torque over time with band and gusts, and its spectral density.

        Raises:
            ValueError: the wind torque is not identifiable.
        """
        return draw_charts(model_charts.wind_torque_charts(self.learned))

    def _training_flights(self) -> list[Flight]:
        """Returns the training data as flights, one for each segment, with the names and units of the model.

        A model keeps its training data as one record. Held-out windows need flights, from which other models are
        trained.
        """
        record = self.learned.record
        labels = Labels.of(self.learned)
        segment_times = np.split(model_charts.sample_times(record), record.segment_starts[1:])
        flights = []
        for time, (inputs, outputs) in zip(segment_times, record.segments, strict=True):
            flights.append(
                Flight(
                    time,
                    inputs,
                    outputs,
                    record.dt,
                    *labels,
                    effect_directions=record.effect_directions,
                )
            )
        return flights
