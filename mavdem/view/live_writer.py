"""Rows of a live flight as lines of a Rerun recording: motion, free energy, parameters, wind and wind torque."""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dem import Estimate
from mavdem.dem.engine.free_energy import Term
from mavdem.live.display import DisplayRow
from mavdem.live.samples import MAX_SAMPLES
from mavdem.report.charts.chart import CLIP_SPANS
from mavdem.report.numbers import TORQUE_UNIT, display_unit, without_remark
from mavdem.report.palette import (
    BAD,
    BAND_OPACITY,
    BOUND,
    DISTINCT,
    DISTURBANCE,
    LIMITED,
    MEASURED,
    PREDICTED,
    TRUTH,
    distinct,
)
from mavdem.report.series import free_energy_per_sample
from mavdem.view.axes import range_with_ticks, tick_intervals
from mavdem.view.first_tab import height_shares
from mavdem.view.live_content import (
    FLIGHT_SECONDS,
    Channels,
    first_tab_paths,
    live_blueprint,
)
from mavdem.view.live_scene import LiveScene
from mavdem.view.parameter_traces import ParameterTrace, parameter_estimates, parameter_traces
from mavdem.view.plots import BOOT_CLOCK, Lines, colour_on_dark

MARK_BREAK_SECONDS = 1e-3
"""Time before a mark at which its line breaks, s: too short to be seen. Without breaks the marks would be joined."""

WIND_EDGE_OPACITY = 0.5
"""Opacity of the lines at the ends of the wind's interval."""

INVISIBLE = (0, 0, 0, 0)
"""Colour of lines that only widen the range of an axis: red, green, blue and opacity."""


CONTINUOUS_SEGMENT = 0
"""Number of the segment of all samples of a line that is not broken where samples are missing."""

# The viewer draws the lines of a plot in the order of their paths, which the numbers in them determine: the band lies
# below the line, and the part of the line that is marked lies above both.
WIND_TORQUE_BAND_PATH = "wind/0_band"
"""Path, in the recording, of the 90 % band of the wind torque."""

WIND_TORQUE_PATH = "wind/1_torque"
"""Path of the line of the wind torque."""

MOTOR_TORQUE_PATH = "wind/2_motor"
"""Path of the part of that line whose torque is a motor's."""


class BandAndLine(NamedTuple):
    """Paths, in the recording, of a line and of the band around it."""

    band: str
    """Path of the band."""
    line: str
    """Path of the line."""


PARAMETER_PATHS = (
    BandAndLine("parameters/0_band", "parameters/3_line"),
    BandAndLine("parameters/1_band", "parameters/4_line"),
    BandAndLine("parameters/2_band", "parameters/5_line"),
)
"""Paths of the three physical parameters; by their numbers no band lies over a line."""


TERM_NAMES = tuple(term.value for term in Term)
"""Names of the terms of F(t), each of which is drawn as a line."""

TERM_COLOURS = tuple(distinct(number) for number in range(len(TERM_NAMES)))
"""Colour of the line of each term, in the order of ``TERM_NAMES``."""


class Sample(NamedTuple):
    """Values of k lines at one time."""

    segment: int
    """Number of the segment, which changes where samples are missing; lines break there."""
    time: float
    """Time on the timeline, s."""
    values: Sequence[float] | Array
    """(k,) value of each line."""


class EstimateWithBand(NamedTuple):
    """An estimated value at one time."""

    segment: int
    """Number of the segment."""
    time: float
    """Time on the timeline, s."""
    value: float
    """The estimate, in the unit of data."""
    half_width: float
    """Half width of its 90 % band, in the same unit."""


class LatestSample(NamedTuple):
    """The last sample of some lines that was drawn."""

    segment: int
    """Number of its segment."""
    time: float
    """Its time on the timeline, s."""


class PlotRange(NamedTuple):
    """Smallest and largest value that were drawn into a plot in one batch of rows."""

    time: float
    """Time of the last sample of the batch, s on the timeline."""
    low: float
    """Smallest value."""
    high: float
    """Largest value."""


class LiveWriter:
    """Draws rows of a live flight as lines of a Rerun recording; all rows have the same channels.

    Attributes:
        channels: names and units of what the rows contain.
        scene: 3D tab of the recording.
    """

    def __init__(self, channels: Channels, recording: rr.RecordingStream, scene: LiveScene) -> None:
        """Starts a recording of a live flight by sending its name and its layout.

        Args:
            channels: names and units of what the rows contain.
            recording: recording to draw into.
            scene: its 3D tab, which draws the poses of the rows; it outlives a change of the channels.
        """
        recording.send_recording_name(channels.title)
        recording.send_blueprint(live_blueprint(channels))
        self.channels = channels
        self._recording = recording
        self.scene = scene
        # Smallest and largest value that was drawn without clipping so far, by the path of the plot.
        self._plot_ranges: dict[str, Interval] = {}
        # Each plot of the first tab has the number of intervals between ticks for which it has room, and the ranges of
        # the batches of rows that are in sight.
        self._tick_intervals = {}
        paths = first_tab_paths(channels.output_names[0])
        for name, share in height_shares(paths).items():
            self._tick_intervals[paths[name]] = tick_intervals(share)
        self._latest_ranges: dict[str, deque[PlotRange]] = {}
        # Name, colour and scale of the lines of the physical parameters; empty before the first estimate of them.
        self._parameter_traces: tuple[ParameterTrace, ...] = ()
        self._latest_samples: dict[Lines, LatestSample] = {}
        # The latest samples of the wind torque: they are marked if an alarm names a motor as their cause.
        self._torque_samples = deque[Sample](maxlen=MAX_SAMPLES)

    def write(self, rows: list[DisplayRow]) -> None:
        """Adds rows of a live flight to the lines of all plots.

        Motors, motion, attitude and wind are drawn from every row. The wind torque, the free energy, the physical
        parameters and the marks of surprising samples are estimates of a model, and drawn only from rows that have
        them.

        Args:
            rows: rows of the live flight, in the order of their times. A row has the inputs and outputs of the model at
                one time and, once there is a model, its estimates.
        """
        motor_names = tuple(without_remark(name) for name in self.channels.input_names)
        motors = Lines("motors/0_outputs", motor_names, DISTINCT[: len(motor_names)])
        motor_outputs = [Sample(row.segment, row.timeline_time, row.inputs) for row in rows]
        self._draw_samples(motors, motor_outputs)
        self._draw_predicted_angle(rows)
        self._draw_attitude(rows)
        self._draw_wind(rows)
        self.scene.draw(rows)
        estimates = [(row, row.estimate) for row in rows if row.estimate is not None]
        self._draw_wind_torque(estimates)
        self._draw_free_energy(estimates)
        self._draw_parameters(estimates)
        self._mark_surprises(estimates)
        self._widen_axes()

    def _mark_surprises(self, estimates: Sequence[tuple[DisplayRow, Estimate]]) -> None:
        """Marks samples that the learner reports as unusual by vertical lines in the plot of the predicted angle.

        Args:
            estimates: rows with their estimates.
        """
        angle_plot = f"axes/{self.channels.output_names[0]}"
        mark = Lines(f"{angle_plot}/8_surprises", ("surprise",), (LIMITED,), is_filled=True)
        for row, estimate in estimates:
            if estimate.unusual:
                self._mark_time(mark, estimate.window_center + row.timeline_offset)

    def mark_motor_torque(self, start_time: float) -> None:
        """Draws the part of the wind torque in red that a weak motor caused, over the line of the wind torque.

        The wind torque is all torque that the model does not explain, so that a loss of thrust looks like wind. The
        loss is detected some seconds after it happened. The red line begins when the motor lost thrust or recovered it,
        and ends now.

        Args:
            start_time: time of the change of the motor, s on the timeline.
        """
        # Samples of one segment are joined to a line. Each alarm has its own segment, numbered by its time.
        segment_number = int(start_time)
        samples = []
        for sample in self._torque_samples:
            if sample.time >= start_time:
                samples.append(Sample(segment_number, sample.time, sample.values))
        red_line = Lines(MOTOR_TORQUE_PATH, ("of a motor",), (BAD,), 3.0)
        self._draw_samples(red_line, samples)

    def mark_alarm(self, time: float) -> None:
        """Marks an alarm by a vertical line in all plots with room for it in their legend: all but the parameters'.

        Args:
            time: time of the alarm, s on the timeline; NaN, for an alarm without a time, marks nothing.
        """
        for plot in self._plot_ranges:
            if plot != "parameters":
                self._mark_time(Lines(f"{plot}/9_alarms", ("alarm",), (BAD,), is_filled=True), time)

    def _mark_time(self, line: Lines, time: float) -> None:
        """Marks a time by a vertical line over the range of the values that were drawn in a plot so far.

        Args:
            line: the line, whose path begins with the path of the plot; all marks with the same meaning share it.
            time: s on the timeline; NaN marks nothing.
        """
        plot_range = self._plot_ranges.get(plot_of(line))
        if not np.isfinite(time) or plot_range is None:
            return
        line.send_style(self._recording)
        # The NaN just before each mark breaks the line, so that marks are not joined.
        edges = np.array([[np.nan, np.nan], plot_range])
        line.send(self._recording, np.array([time - MARK_BREAK_SECONDS, time]), edges)

    def _widen_axes(self) -> None:
        """Draws two invisible lines in each plot of the first tab, so that its axis has enough numbered ticks.

        The viewer fits the axis of values to all visible lines, and cannot be given a range that changes with time. So
        the range of the values in the last ``FLIGHT_SECONDS`` is widened until it has enough ticks, and an invisible
        line is drawn at either end of it.
        """
        for plot, ranges in self._latest_ranges.items():
            newest_time = ranges[-1].time
            while ranges[0].time < newest_time - FLIGHT_SECONDS:
                ranges.popleft()
            lowest_value = min(batch.low for batch in ranges)
            highest_value = max(batch.high for batch in ranges)
            ends = range_with_ticks(lowest_value, highest_value, self._tick_intervals[plot])
            self._recording.set_time(BOOT_CLOCK, duration=newest_time)
            self._recording.log(axis_path(plot), rr.Scalars(ends))

    def _draw_samples(self, lines: Lines, samples: Sequence[Sample], clip: bool = False) -> None:
        """Adds samples to lines; the lines are interrupted where a new segment begins.

        Only samples later than the last drawn one are added. Lines without any finite value so far, such as a setpoint
        that the vehicle does not send, are not drawn at all, and do not enter the legend.

        Args:
            lines: the lines, an entity of the recording.
            samples: samples in the order of their times.
            clip: whether to clip values far beyond the measured range so far, which would otherwise determine the range
                of the axis.
        """
        former_sample = self._latest_samples.get(lines, LatestSample(CONTINUOUS_SEGMENT, -np.inf))
        new_samples = _samples_after(former_sample.time, samples)
        if not new_samples:
            return
        values = np.array([sample.values for sample in new_samples], np.float64)
        has_been_drawn = lines in self._latest_samples
        if not has_been_drawn:
            if not np.isfinite(values).any():
                return
            lines.send_style(self._recording)
        latest_sample = new_samples[-1]
        self._latest_samples[lines] = LatestSample(latest_sample.segment, latest_sample.time)
        plot = plot_of(lines)
        plot_range = self._plot_ranges.get(plot)
        if clip and plot_range is not None:
            values = _clipped_to_plot(values, plot_range)
        else:
            self._extend_plot_range(plot, values)
        self._store_range(lines, latest_sample.time, values)
        time = np.array([sample.time for sample in new_samples])
        segments = np.array([sample.segment for sample in new_samples])
        # The rows at which another segment begins than that of the sample before; a NaN just before each of them breaks
        # the line.
        break_rows = np.flatnonzero(np.diff(segments, prepend=former_sample.segment))
        break_times = time[break_rows] - self.channels.dt / 2
        lines.send(
            self._recording,
            np.insert(time, break_rows, break_times),
            np.insert(values, break_rows, np.nan, axis=0),
        )

    def _store_range(self, lines: Lines, time: float, values: Array) -> None:
        """Stores the range of new values in a plot of the first tab, from which :meth:`_widen_axes` chooses its axis.

        Args:
            lines: the lines that the values are drawn by; for lines of another tab nothing is stored.
            time: time of the last sample, s on the timeline.
            values: (N, k) values of k lines.
        """
        plot = plot_of(lines)
        finite_values = values[np.isfinite(values)]
        if plot not in self._tick_intervals or not len(finite_values):
            return
        ranges = self._latest_ranges.setdefault(plot, deque())
        if not ranges:
            # Two invisible lines widen the axis. The viewer shows one entry in the legend for all lines of the same
            # name, so that they have the name of a visible one.
            style = rr.SeriesLines(names=[lines.names[0]] * 2, colors=[INVISIBLE] * 2)
            self._recording.log(axis_path(plot), style, static=True)
        ranges.append(PlotRange(time, float(finite_values.min()), float(finite_values.max())))

    def _extend_plot_range(self, plot: str, values: Array) -> None:
        """Extends the range of a plot, within which values of other lines are clipped, so that it includes new values.

        Args:
            plot: path of the plot.
            values: (N, k) values of k lines; those that are not finite are left out.
        """
        finite_values = values[np.isfinite(values)]
        if not len(finite_values):
            return
        low, high = float(finite_values.min()), float(finite_values.max())
        former_range = self._plot_ranges.get(plot)
        if former_range is not None:
            former_low, former_high = former_range
            low, high = min(former_low, low), max(former_high, high)
        self._plot_ranges[plot] = low, high

    def _draw_predicted_angle(self, rows: list[DisplayRow]) -> None:
        """Draws the measured angle of the model's axis, and its prediction for a fraction of a second ahead.

        The prediction is the one at the learner's horizon nearest to ``REPORTED_HORIZON``. It is drawn at the predicted
        time, not at the time at which it was made. Rows without an estimate give NaN, which interrupts the line.

        Args:
            rows: rows of the live flight, in the order of their times.
        """
        horizon = self.channels.shown_horizon
        seconds = self.channels.horizons[horizon] * self.channels.dt
        scale = display_unit(self.channels.output_units[0]).scale
        plot = f"axes/{self.channels.output_names[0]}"
        # The numbers in the paths put the band below the lines.
        measured_line = Lines(f"{plot}/1_measured", ("measured",), (MEASURED,), 1.2)
        self._draw_samples(
            measured_line,
            [Sample(row.segment, row.timeline_time, scale * row.outputs[:1]) for row in rows],
        )
        predictions = [_predicted_angle(row, horizon, seconds) for row in rows]
        predicted_line = Lines(
            f"{plot}/2_predicted", (f"{seconds:.2g} s ahead",), (PREDICTED,), 1.8
        )
        self._draw_with_band(f"{plot}/0_band", predicted_line, predictions, scale, clip=True)

    def _draw_with_band(
        self,
        band_path: str,
        line: Lines,
        estimates: list[EstimateWithBand],
        scale: float,
        clip: bool = False,
    ) -> list[Sample]:
        """Draws estimates as a line, and their 90 % intervals as a shaded band around it.

        Args:
            band_path: path of the band's data in the recording.
            line: name, colour and path of the line in the recording.
            estimates: estimates with the half widths of their intervals, in the order of their times.
            scale: factor from the unit of the estimates to the unit that is shown.
            clip: whether to clip values far beyond what was measured so far.

        Returns:
            The samples of the line, in the shown unit.
        """
        line_samples = []
        band_samples = []
        for segment, time, value, half_width in estimates:
            line_samples.append(Sample(segment, time, [scale * value]))
            edges = [scale * (value - half_width), scale * (value + half_width)]
            band_samples.append(Sample(segment, time, edges))
        shade = colour_on_dark(line.colours[0], BAND_OPACITY)
        band = Lines(band_path, ("90 % band",), (shade,), is_filled=True)
        # The band is drawn first, so that the line lies over it.
        self._draw_samples(band, band_samples, clip)
        self._draw_samples(line, line_samples, clip)
        return line_samples

    def _draw_attitude(self, rows: list[DisplayRow]) -> None:
        """Draws the measured attitude of all axes, in degrees: angles, setpoints of roll and pitch, and body rates.

        The measured angle of the model's axis is left out here, since it is drawn together with its prediction.
        Setpoints are clipped, since a pilot's command may lie far beyond the angles that are flown.

        Args:
            rows: rows in the order of their times. The attitude is the pose of a row, which has a time of its own; rows
                without a pose are skipped.
        """
        angles: list[Sample] = []
        setpoints: list[Sample] = []
        rates: list[Sample] = []
        for row in rows:
            if row.pose is not None:
                time = row.pose.time + row.timeline_offset
                angles.append(Sample(row.segment, time, np.degrees(row.pose.angles)))
                setpoints.append(Sample(row.segment, time, np.degrees(row.pose.setpoint)))
                rates.append(Sample(row.segment, time, np.degrees(row.pose.rates)))
        # The viewer draws lines in the order of their paths: by their numbers, setpoints lie below measurements.
        for number, axis in enumerate(AXES):
            if axis not in self.channels.output_names:
                line = Lines(f"axes/{axis}/1_measured", (axis,), (MEASURED,))
                self._draw_samples(line, _samples_of_line(angles, number))
        for number, axis in enumerate(TILT_AXES):
            line = Lines(f"axes/{axis}/0_asked", ("setpoint",), (TRUTH,))
            self._draw_samples(line, _samples_of_line(setpoints, number), clip=True)
        self._draw_samples(Lines("rates", AXES, DISTINCT[: len(AXES)]), rates)

    def _draw_wind(self, rows: list[DisplayRow]) -> None:
        """Draws the estimated wind speed, m/s, and the two ends of its 90 % interval as lines over time.

        The lines go on over gaps in the flight.

        Args:
            rows: samples of the flight at one time each, in the order of time; those without an estimate of the wind
                are skipped.
        """
        speeds = []
        edges = []
        for row in rows:
            if row.wind is not None:
                time = row.wind.time + row.timeline_offset
                wind = row.wind.compass
                speeds.append(Sample(CONTINUOUS_SEGMENT, time, [wind.speed]))
                edges.append(Sample(CONTINUOUS_SEGMENT, time, [wind.speed_low, wind.speed_high]))
        edge_colour = colour_on_dark(DISTURBANCE, WIND_EDGE_OPACITY)
        # Estimates are half a second apart, so that a band of vertical strokes would have gaps: its edges are lines.
        names = ("90 % band", "90 % band")
        self._draw_samples(Lines("air/0_band", names, (edge_colour, edge_colour)), edges)
        self._draw_samples(Lines("air/1_speed", ("wind",), (DISTURBANCE,)), speeds)

    def _draw_parameters(self, estimates: Sequence[tuple[DisplayRow, Estimate]]) -> None:
        """Draws control effectiveness, damping and motor time constant, each with its 90 % band.

        They are the physical parameters of the latest model; early in a flight there are none yet.

        Args:
            estimates: rows with their estimates; those without physical parameters are skipped.
        """
        samples_by_parameter: list[list[EstimateWithBand]] = [[] for _ in PARAMETER_PATHS]
        for row, estimate in estimates:
            if estimate.physical is None:
                continue
            if not self._parameter_traces:
                unit = self.channels.input_units[0]
                self._parameter_traces = parameter_traces(estimate.physical, unit)
            parameters = parameter_estimates(estimate.physical).tolist()
            for samples, (value, half_width) in zip(samples_by_parameter, parameters, strict=True):
                samples.append(EstimateWithBand(row.segment, row.timeline_time, value, half_width))
        # There are no traces before the first parameters.
        for trace, paths, samples in zip(
            self._parameter_traces, PARAMETER_PATHS, samples_by_parameter, strict=False
        ):
            line = Lines(paths.line, (trace.name,), (trace.colour,))
            self._draw_with_band(paths.band, line, samples, trace.scale)

    def _draw_wind_torque(self, estimates: Sequence[tuple[DisplayRow, Estimate]]) -> None:
        """Draws the estimated wind torque with its 90 % band, at the time at which it acted.

        The torque is estimated with a delay, so that it acted before the time of the row. The samples are stored,
        because the torque of the last seconds may turn out to be caused by a failed motor (:meth:`mark_motor_torque`).

        Args:
            estimates: rows with their estimates, whose torques are divided by the moment of inertia: angular
                accelerations, rad/s².
        """
        torques = []
        for row, estimate in estimates:
            if np.isfinite(estimate.wind_time):
                torques.append(
                    EstimateWithBand(
                        segment=CONTINUOUS_SEGMENT,
                        time=estimate.wind_time + row.timeline_offset,
                        value=estimate.wind_torque,
                        half_width=estimate.wind_torque_band,
                    )
                )
        line = Lines(WIND_TORQUE_PATH, ("torque",), (DISTURBANCE,))
        self._torque_samples += self._draw_with_band(
            WIND_TORQUE_BAND_PATH, line, torques, TORQUE_UNIT.scale
        )

    def _draw_free_energy(self, estimates: Sequence[tuple[DisplayRow, Estimate]]) -> None:
        """Draws the free energy F(t) of each sample, nats, with its terms and the surprise, and F̄ of each model.

        F(t) measures how well a sample agrees with the model; surprise measures how far it drops below its recent
        median. F(t) is known only when the window of samples around a time is complete, so it is drawn at the centre of
        the window, ``estimate.window_center``. The free energy action F̄ of a model is drawn at the last sample of its
        training data; divided by the number of these samples, it is the mean of their F(t). A constant line at 1 shows
        the surprise that one of twenty samples exceeds without a change.

        Args:
            estimates: rows with their estimates.
        """
        energies = []
        terms = []
        actions = []
        surprises = []
        energies_per_sample = []
        for row, estimate in estimates:
            if np.isfinite(estimate.window_center):
                time = estimate.window_center + row.timeline_offset
                energies.append(Sample(CONTINUOUS_SEGMENT, time, [estimate.free_energy]))
                if estimate.free_energy_terms is not None:
                    terms.append(Sample(CONTINUOUS_SEGMENT, time, estimate.free_energy_terms))
                end_time = estimate.training_end_time + row.timeline_offset
                actions.append(Sample(CONTINUOUS_SEGMENT, end_time, [estimate.free_energy_action]))
                # The first value is the constant line.
                surprises.append(Sample(CONTINUOUS_SEGMENT, time, [1.0, estimate.surprise]))
            if row.learned is not None and np.isfinite(estimate.training_end_time):
                end_time = estimate.training_end_time + row.timeline_offset
                per_sample = free_energy_per_sample(row.learned)
                energies_per_sample.append(Sample(CONTINUOUS_SEGMENT, end_time, [per_sample]))
        self._draw_samples(Lines("free_energy/0_samples", ("F(t)",), (MEASURED,)), energies)
        learning_runs = Lines("free_energy/1_runs", ("F̄ per sample",), (PREDICTED,), 3.0)
        self._draw_samples(learning_runs, energies_per_sample)
        self._draw_samples(Lines("free_energy_terms", TERM_NAMES, TERM_COLOURS), terms)
        self._draw_samples(Lines("free_energy_action", ("F̄",), (PREDICTED,)), actions)
        surprise_lines = Lines("surprise/samples", ("worst of 20", "surprise"), (BOUND, PREDICTED))
        self._draw_samples(surprise_lines, surprises)


def _samples_of_line(samples: Sequence[Sample], column: int) -> list[Sample]:
    """Selects one line from samples that have the values of several lines at the same times.

    Args:
        samples: samples of k lines, each with k values.
        column: index of the line.

    Returns:
        Samples with one value each.
    """
    return [sample._replace(values=sample.values[column : column + 1]) for sample in samples]


def _clipped_to_plot(values: Array, plot_range: Interval) -> Array:
    """Clips values to the range of their plot, extended on both sides by ``CLIP_SPANS`` times its span.

    Args:
        values: (N, k) values of k lines.
        plot_range: lower and upper end of the range.
    """
    low, high = plot_range
    margin = CLIP_SPANS * (high - low)
    return np.clip(values, low - margin, high + margin)


def axis_path(plot: str) -> str:
    """Returns the entity of the invisible lines that widen the axis of a plot."""
    return f"{plot}/90_axis"


def _predicted_angle(row: DisplayRow, horizon: int, seconds: float) -> EstimateWithBand:
    """Returns the prediction of the angle that was made at the time of a row.

    Args:
        row: the row, with the estimate of the learner if there is one.
        horizon: index of the prediction among those of the learner, which are for several times ahead.
        seconds: how far ahead this prediction is, s.

    Returns:
        The prediction at the predicted time; NaN without an estimate.
    """
    estimate = row.estimate
    if estimate is None:
        return EstimateWithBand(row.segment, row.timeline_time + seconds, np.nan, np.nan)
    # The angle is the first output of the model.
    return EstimateWithBand(
        row.segment,
        estimate.ahead_times[horizon] + row.timeline_offset,
        estimate.ahead[horizon, 0],
        estimate.ahead_band[horizon, 0],
    )


def _samples_after(time: float, samples: Sequence[Sample]) -> list[Sample]:
    """Returns the samples that are later than a time; of several samples with the same time only the last one.

    Args:
        time: s on the timeline.
        samples: samples in the order of their times.
    """
    # A dictionary keeps the last of several values under one key.
    samples_by_time = {sample.time: sample for sample in samples if sample.time > time}
    return list(samples_by_time.values())


def plot_of(lines: Lines) -> str:
    """Returns the path of the plot that lines are drawn in: all but the last part of their own."""
    return lines.path.rpartition("/")[0] or lines.path
