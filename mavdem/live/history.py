"""The history of a live flight: its events, its signals over time, and how well each sample was predicted."""

from array import array
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from math import inf, isfinite, nan
from operator import itemgetter
from typing import NamedTuple, Self

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Names
from mavdem.dataset.intervals import TimeInterval, intersection
from mavdem.dataset.setpoints import STAMP_ROUNDING
from mavdem.dem import Estimate
from mavdem.facts.event import Event

REPORTED_HORIZON = 0.25
"""Horizon whose prediction errors are shown, s: a choice."""

HORIZONS = (0.05, 0.1, REPORTED_HORIZON, 0.5)
"""Horizons that a live session predicts besides one step, s: a choice."""

MAX_ROWS = 10_000
"""Rows that the history keeps, a choice: about 2 MB, and more than the pixels of any chart.

When there are more, every second one is dropped, and from then on only every second one is added.
"""

MAX_EVENTS = 500
"""Events that the history keeps, a choice: a page with them is rendered in a fraction of a second.

A vehicle reports fewer in an hour, unless it sends very many different texts.
"""

GAP_SECONDS = 1.0
"""Time between two learned samples from which on they count as two parts of the flight, s: a choice.

It is also the shortest gap that the timeline shows at a reboot of the vehicle.
"""

MAX_WITHDRAWN_SECONDS = 10.0
"""Longest time before its report for which a landing or a loss of control is withdrawn, s.

A landing counts for ``TRANSIENT_SECONDS`` before the touch-down, which autopilots report some seconds later: a choice.
"""

SECONDS_AFTER_LANDING = 5.0
"""Time after a flight that its plots show, s: a choice, in which the motors come to rest after the touch-down."""

SAMPLE_PERIOD = 0.1
"""Time between two samples of the motion in the history while there are no rows, s: a choice, finer than plots show."""

COLUMNS_BEFORE_MOTORS = 17
"""Columns of a history row before the columns of the motors: ``LiveHistory.table`` lists them."""

TIME_COLUMN = 1
"""Column of a history row with its time."""

TORQUE_COLUMNS = slice(5, 7)
"""Columns of a history row with the wind torque and the half width of its band."""


def horizon_steps(dt: float) -> tuple[int, ...]:
    """Returns the horizons that a live session predicts, ascending, in steps of ``dt`` s."""
    steps = {1}
    for seconds in HORIZONS:
        steps.add(max(1, round(seconds / dt)))
    return tuple(sorted(steps))


class HorizonErrors(NamedTuple):
    """Errors of the predictions at one horizon, inputs unknown, for each of the m outputs."""

    seconds: float
    """The horizon, s."""

    samples: int
    """Number of predictions that were compared with a measurement."""

    mse: Array
    """(m,) Mean squared error."""

    baseline_mse: Array
    """(m,) Mean squared error of holding the last sample instead."""

    coverage: Array
    """(m,) Share of the measurements inside the 90 % band."""


class _Prediction(NamedTuple):
    """A prediction that waits for its measurement."""

    time: float
    """Time that is predicted, s of the timeline."""

    outputs: list[float]
    """Predicted outputs, m of them. A few numbers are handled faster one by one than as an array."""

    band: list[float]
    """Half widths of their 90 % band."""

    last_sample: list[float]
    """Outputs when the prediction was made: the baseline holds them."""


@dataclass
class _ErrorSums:
    """Sums over the predictions at one horizon that were compared with a measurement."""

    squares: list[float]
    """Squared errors of the predictions, of each of the m outputs."""

    baseline_squares: list[float]
    """Squared errors of holding the last sample instead."""

    inside: list[int]
    """Number of measurements inside the 90 % band."""

    count: int = 0
    """Number of predictions."""

    @classmethod
    def zero(cls, output_count: int) -> Self:
        """Returns the sums before any prediction was compared: all zero.

        Args:
            output_count: number of predicted outputs, m.
        """
        return cls(
            squares=[0.0] * output_count,
            baseline_squares=[0.0] * output_count,
            inside=[0] * output_count,
        )

    def add(self, prediction: _Prediction, outputs: list[float]) -> None:
        """Adds the errors of a prediction, and of its baseline, to the sums.

        Args:
            prediction: prediction that has m predicted outputs with half widths of their band, and the outputs at the
                time when it was made: the baseline predicts that they stay.
            outputs: the m outputs that were measured at the predicted time.
        """
        for column, measured in enumerate(outputs):
            error = measured - prediction.outputs[column]
            baseline_error = measured - prediction.last_sample[column]
            self.squares[column] += error**2
            self.baseline_squares[column] += baseline_error**2
            if abs(error) <= prediction.band[column]:
                self.inside[column] += 1
        self.count += 1


class _Comparison(NamedTuple):
    """A prediction whose time has come."""

    horizon: float
    """How far ahead it was made, s."""

    prediction: _Prediction
    """The prediction."""

    outputs: list[float]
    """The m outputs that were measured at its time."""

    @property
    def time(self) -> float:
        """Its time, s of the timeline."""
        return self.prediction.time


def _add_prediction_error(error_sums: dict[float, _ErrorSums], comparison: _Comparison) -> None:
    """Adds the error of a prediction to the sums of its horizon, which is how far ahead it was made.

    Args:
        error_sums: sums of errors by horizon, s; the sums of one horizon are changed.
        comparison: the prediction, its horizon, and the outputs that were measured at the predicted time.
    """
    horizon = comparison.horizon
    if horizon not in error_sums:
        error_sums[horizon] = _ErrorSums.zero(output_count=len(comparison.outputs))
    error_sums[horizon].add(comparison.prediction, comparison.outputs)


def _without_frequent_events(events: Sequence[Event]) -> list[Event]:
    """Returns the events without every second one of the older half of the most frequent kind.

    Rare events stay. So a vehicle that sends very many texts does not push its take-off out of the history.

    Args:
        events: events in the order of time, at least one.
    """
    counts_by_code = Counter(event.fact.code for event in events)
    [(most_frequent_code, frequent_count)] = counts_by_code.most_common(1)
    kept_events = []
    # Number of the event among those of the most frequent kind, from 1.
    frequent_number = 0
    for event in events:
        if event.fact.code is most_frequent_code:
            frequent_number += 1
            is_of_older_half = frequent_number <= frequent_count / 2
            is_every_second = frequent_number % 2 == 0
            if is_of_older_half and is_every_second:
                continue
        kept_events.append(event)
    return kept_events


class _PredictedAngle(NamedTuple):
    """A predicted angle; NaN without a prediction."""

    angle: float = nan
    """Angle, rad."""

    half_width: float = nan
    """Half width of its 90 % band, rad."""


class ShownFlight(NamedTuple):
    """The flight that the signals of a history are of: the latest one."""

    number: int = 0
    """Its number in the session, from 1; 0 before the first take-off."""

    start: float = -inf
    """When it began, s of the timeline."""

    end: float = inf
    """When the vehicle was in the air last, s of the timeline; infinity before the first flight."""

    boot: int = 0
    """Number of the boot in which it began, from 0, on whose clock its times are shown."""

    timeline_offset: float = 0.0
    """Time of the timeline minus time of that boot's clock, s."""

    def contains(self, time: float) -> bool:
        """Returns whether a time, s of the timeline, is in the flight or in the seconds after it; NaN is not."""
        return self.start <= time <= self.end + SECONDS_AFTER_LANDING


class LiveHistory:
    """The events of a live session, and the signals of its latest flight with the errors of their predictions.

    The memory is bounded. The timeline is the boot clock of the vehicle's first boot, in seconds. If the vehicle
    reboots and its clock begins again, the timeline goes on: it is ``timeline_offset`` seconds ahead of the present
    boot's clock.

    Attributes:
        now: latest time of the timeline, s; NaN before any.
        timeline_offset: time of the timeline minus time of the present boot's clock, s.
        boot: number of the boot whose clock the timeline follows now, from 0.
        boot_start: time of the timeline when that boot was first received, s; NaN before any. Positions of earlier
            boots may have another origin.
        motor_names: names of the motors in ``table``.
        events: what happened, in order, with times of the timeline. There are ``MAX_EVENTS`` at most.
        alarm_count: number of alarms so far, also of those that are not kept any more.
        flight: the flight that the signals are of; before the first take-off, all that was received.
        learned_intervals: first and last sample, s, of each part of the flight that was learned from.
    """

    def __init__(self) -> None:
        """Makes an empty history, whose timeline has no time yet."""
        self.now = nan
        self.timeline_offset = 0.0
        self.motor_names: Names = ()
        self.events: list[Event] = []
        self.alarm_count = 0
        self.flight = ShownFlight()
        self.learned_intervals: list[TimeInterval] = []
        self.boot = 0
        self.boot_start = nan
        # The latest ``MAX_ROWS`` samples of each battery: time, s of the timeline, and voltage, V.
        self._voltages: dict[int, deque[tuple[float, float]]] = {}
        # Columns as ``table`` lists them. Of all rows that were added, every ``_stride``-th one is kept.
        self._rows: list[array[float]] = []
        self._stride = 1
        self._row_count = 0
        # Number of the segment of the latest row.
        self._segment = 0
        # Both by horizon, s: predictions whose time has not come, and the errors of those whose time has.
        self._predictions: dict[float, deque[_Prediction]] = {}
        self._error_sums: dict[float, _ErrorSums] = {}
        # Predictions of the last ``MAX_WITHDRAWN_SECONDS``, which are not in these sums yet, in the order of time.
        self._comparisons: deque[_Comparison] = deque()

    def advance(self, time: float, boot: int, restart_seconds: float = GAP_SECONDS) -> None:
        """Advances the timeline to a time on the vehicle's clock; the timeline never goes back.

        After a reboot the clock begins again. The timeline then continues after the time for which nothing was
        received, so that a gap is drawn as long as it was, but at least ``GAP_SECONDS`` after its last time, so that
        events of two boots keep their order.

        Args:
            time: time on the boot clock, s; NaN, for a time that is not known yet, does not move a timeline that has
                begun.
            boot: number of the boot; another number than before means that the clock has begun again.
            restart_seconds: time from the last message of the boot before to the first one of this boot, s.
        """
        if boot != self.boot:
            self.boot = boot
            self.boot_start = self.now + max(restart_seconds, GAP_SECONDS)
            self.timeline_offset = self.boot_start - time
        timeline_time = time + self.timeline_offset
        # Comparisons with NaN are false: so a timeline without a time yet takes any time.
        would_go_back = timeline_time <= self.now
        if not would_go_back:
            self.now = timeline_time

    def note_flight(self, number: int, takeoff_time: float) -> None:
        """Notes that the vehicle is in the air now, and begins another flight if the number is a new one.

        Then signals, predictions and their errors from before the take-off are forgotten: the page shows the data by
        which the flight is judged, and these are of this flight alone.

        Args:
            number: number of the flight in the session, from 1.
            takeoff_time: when it began, s of the present boot's clock; minus infinity where that was not seen.
        """
        if number != self.flight.number:
            # The offset turns times of the boot clock into times of the timeline, which goes on after a reboot.
            start_time = takeoff_time + self.timeline_offset
            is_first_flight = self.flight.number == 0
            if not isfinite(start_time) and not is_first_flight:
                # The take-off was not seen, so that the signals until now may be of the flight before.
                start_time = self.now
            self.flight = ShownFlight(
                number, start_time, boot=self.boot, timeline_offset=self.timeline_offset
            )
            self._forget_signals_before(start_time)
        self.flight = self.flight._replace(end=self.now)

    def _forget_signals_before(self, start_time: float) -> None:
        """Forgets the signals of the time before a flight, when that flight has just been noticed.

        Rows (samples of the motion, which the page plots) and learned intervals are kept from the beginning of the
        flight on. Voltages, predictions and their errors are all forgotten, and collected anew.

        Args:
            start_time: beginning of the flight, s of the timeline.
        """
        self._rows = [row for row in self._rows if row[TIME_COLUMN] >= start_time]
        # Long flights keep only every ``_stride``-th row. A new flight begins with each of its rows.
        self._stride = 1
        self._voltages.clear()
        self._predictions.clear()
        self._comparisons.clear()
        self._error_sums.clear()
        self.learned_intervals = intersection(self.learned_intervals, [(start_time, inf)])

    def add_event(self, event: Event) -> None:
        """Adds an event; where there are too many, drops some of the older ones of the most frequent kind.

        Args:
            event: the event, with its time on the timeline.
        """
        self.events.append(event)
        if event.is_alarm:
            self.alarm_count += 1
        if len(self.events) > MAX_EVENTS:
            self.events = _without_frequent_events(self.events)

    def add_voltages(self, voltages: Mapping[int, float]) -> None:
        """Adds the voltage of each battery at the present time of the timeline; the same time once only.

        Args:
            voltages: voltages, V, by number of the battery, from 1.
        """
        if not isfinite(self.now):
            return
        for number, voltage in voltages.items():
            # Times, s of the timeline, and voltages, V.
            samples = self._voltages.setdefault(number, deque(maxlen=MAX_ROWS))
            latest_time = None
            if samples:
                latest_time, _ = samples[-1]
            if latest_time != self.now:
                samples.append((self.now, voltage))

    @property
    def voltages(self) -> dict[int, Array]:
        """(N, 2) Times of the timeline, s, and voltages then, V, by number of the battery, from 1."""
        return {number: np.array(samples) for number, samples in self._voltages.items()}

    def add_row(
        self,
        segment: int,
        time: float,
        outputs: Array,
        estimate: Estimate | None,
        further_values: Sequence[float] = (),
    ) -> None:
        """Adds a sample of the flight (a row), and compares it with the predictions that were made of it.

        The earlier predictions for this time are compared with the measured outputs, the row is kept, and the
        predictions of its estimate are queued until their times are measured.

        Args:
            segment: number of the row's segment; it changes at gaps, across which nothing is compared.
            time: s of the present boot's clock.
            outputs: (m,) measured angle, rad, and rate, rad/s.
            estimate: the learner's estimate; None for a row that was not learned from.
            further_values: wind speed and half width of its band, m/s; roll, pitch and their setpoints, rad; yaw, rad;
                position north and east, and height, m; then each motor as a fraction of its range.
        """
        timeline_time = time + self.timeline_offset
        is_new_segment = segment != self._segment
        if is_new_segment:
            self._segment = segment
            self._predictions.clear()
        output_values = outputs.tolist()
        predicted_angle, predicted_band = self._compare_predictions(timeline_time, output_values)
        wind_torque = nan
        wind_torque_band = nan
        if estimate is not None:
            wind_torque = estimate.wind_torque
            wind_torque_band = estimate.wind_torque_band
        # The columns of ``table``.
        angle_columns = (segment, timeline_time, output_values[0], predicted_angle, predicted_band)
        columns = (*angle_columns, wind_torque, wind_torque_band, *further_values)
        self._keep_row(array("d", columns))
        if estimate is not None:
            self._extend_learned_interval(timeline_time, is_new_segment=is_new_segment)
            self._queue_predictions(timeline_time, output_values, estimate)

    def _keep_row(self, row: "array[float]") -> None:
        """Keeps a row of the history in bounded memory, or skips it.

        A full history drops every second row, and keeps half as many of the rows that follow: its resolution is the
        same over the whole flight. A row that is earlier than the latest one is skipped, too, so that the times of kept
        rows never go back. Such rows come when the model begins: they are of times at which slower samples were added.

        Args:
            row: values of the columns of ``table``.
        """
        if self._rows and row[TIME_COLUMN] < self._rows[-1][TIME_COLUMN]:
            return
        self._row_count += 1
        # Only every ``_stride``-th row is kept.
        if self._row_count % self._stride != 0:
            return
        self._rows.append(row)
        if len(self._rows) > MAX_ROWS:
            self._rows = self._rows[::2]
            self._stride *= 2

    def _extend_learned_interval(self, time: float, *, is_new_segment: bool) -> None:
        """Extends the latest interval of learned samples by one sample, or begins another interval.

        Another begins with a new segment, and after ``GAP_SECONDS`` without a learned sample.

        Args:
            time: time of the sample, s of the timeline.
            is_new_segment: whether the sample is the first of its segment.
        """
        start_time = time
        if self.learned_intervals and not is_new_segment:
            last_start, last_end = self.learned_intervals[-1]
            continues_last_interval = time - last_end < GAP_SECONDS
            if continues_last_interval:
                # The last interval is replaced by a longer one.
                self.learned_intervals.pop()
                start_time = last_start
        self.learned_intervals.append((start_time, time))

    def forget_learned_since(self, start_time: float) -> None:
        """Removes from the learned intervals, and from the errors of predictions, what was withdrawn from the model.

        In a tumble, or on the ground, no model of free flight predicts anything.

        Args:
            start_time: time of the first withdrawn sample, s of the present boot's clock.
        """
        withdrawal_time = start_time + self.timeline_offset
        self._predictions.clear()
        kept_comparisons = [
            comparison for comparison in self._comparisons if comparison.time < withdrawal_time
        ]
        self._comparisons = deque(kept_comparisons)
        kept_intervals = [(-inf, withdrawal_time)]
        self.learned_intervals = intersection(self.learned_intervals, kept_intervals)

    def _queue_predictions(self, time: float, outputs: list[float], estimate: Estimate) -> None:
        """Keeps an estimate's predictions, in a queue for each horizon, until the predicted time is measured.

        Args:
            time: time of the row that the estimate is of, s of the timeline.
            outputs: the row's m measured outputs: the baseline predicts that they stay.
            estimate: estimate with predicted outputs and half widths of their band, (K, m), for K times ahead.
        """
        predicted_times = (estimate.ahead_times + self.timeline_offset).tolist()
        predicted_outputs = estimate.ahead.tolist()
        bands = estimate.ahead_band.tolist()
        for predicted_time, values, band in zip(
            predicted_times, predicted_outputs, bands, strict=True
        ):
            # Rounded to microseconds, so that all predictions at one horizon have the same key.
            horizon = round(predicted_time - time, 6)
            queue = self._predictions.setdefault(horizon, deque())
            queue.append(_Prediction(predicted_time, values, band, outputs))

    def _compare_predictions(self, time: float, outputs: list[float]) -> _PredictedAngle:
        """Compares the predictions for one time with the measurement at that time.

        The horizon of a prediction is how far ahead it was made, s. Each horizon has a queue in which its predictions
        wait until their time comes, in the order of their times, so those that are due are at its front. Predictions
        for a time that was never measured, and those that are not finite, are dropped.

        Args:
            time: time on the timeline, s.
            outputs: measured values of the m outputs of the model, rad or rad/s.

        Returns:
            The angle that was predicted ``REPORTED_HORIZON`` before.
        """
        reported_angle = _PredictedAngle()
        # Horizons are whole steps, so that the one nearest to ``REPORTED_HORIZON`` is reported.
        reported_horizon = min(
            self._predictions, key=lambda seconds: abs(seconds - REPORTED_HORIZON), default=nan
        )
        for horizon, predictions in self._predictions.items():
            while predictions and predictions[0].time < time + STAMP_ROUNDING:
                prediction = predictions.popleft()
                # An earlier prediction that is still in the queue is one for a time at which no sample came.
                was_never_measured = prediction.time < time - STAMP_ROUNDING
                numbers = prediction.outputs + prediction.band
                is_finite = all(isfinite(number) for number in numbers)
                if was_never_measured or not is_finite:
                    continue
                self._comparisons.append(_Comparison(horizon, prediction, outputs))
                if horizon == reported_horizon:
                    reported_angle = _PredictedAngle(prediction.outputs[0], prediction.band[0])
        self._sum_confirmed_errors(time)
        return reported_angle

    def _sum_confirmed_errors(self, time: float) -> None:
        """Adds the errors of predictions to the sums once they can no longer be withdrawn.

        They are withdrawn where a landing or a loss of control is recognised some seconds after it began.

        Args:
            time: time of the latest row, s of the timeline. Comparisons of the last ``MAX_WITHDRAWN_SECONDS`` wait.
        """
        confirmed_time = time - MAX_WITHDRAWN_SECONDS
        while self._comparisons and self._comparisons[0].time < confirmed_time:
            confirmed_comparison = self._comparisons.popleft()
            _add_prediction_error(self._error_sums, confirmed_comparison)

    def clear_wind_torque(self, start_time: float) -> None:
        """Makes the wind torque of earlier rows unknown (NaN), since a weak motor caused it, not the wind.

        A weak motor is recognised some seconds after it became weak. Until then its torque was taken for the wind's.

        Args:
            start_time: time from which on the torque is cleared, s of the timeline. NaN clears nothing.
        """
        for number, row in enumerate(self._rows):
            if row[TIME_COLUMN] >= start_time:
                cleared_row = array("d", row)
                # The torque and the half width of its band.
                cleared_row[TORQUE_COLUMNS] = array("d", (nan, nan))
                self._rows[number] = cleared_row

    def errors(self) -> list[HorizonErrors]:
        """Returns the errors with which the flight's outputs were predicted, for each horizon, the shortest first.

        A horizon is how far ahead a prediction was made, s. For each there are the mean squared error of the
        predictions of the m outputs, the same of the baseline, which predicts that the outputs stay as they were, and
        the share of measurements within the predicted 90 % band (the coverage).
        """
        # The latest comparisons are not in the sums of this flight yet, since they may still be withdrawn.
        error_sums = deepcopy(self._error_sums)
        for comparison in self._comparisons:
            _add_prediction_error(error_sums, comparison)
        errors = []
        for seconds, sums in sorted(error_sums.items(), key=itemgetter(0)):
            errors.append(
                HorizonErrors(
                    seconds,
                    sums.count,
                    mse=np.array(sums.squares) / sums.count,
                    baseline_mse=np.array(sums.baseline_squares) / sums.count,
                    coverage=np.array(sums.inside) / sums.count,
                )
            )
        return errors

    @property
    def table(self) -> Array:
        """The kept rows of the latest flight, until ``SECONDS_AFTER_LANDING`` after it: N rows of 17 + k columns.

        Values that a row lacks are NaN. The columns are, in this order:

        - 0, 1: number of the segment; time, s of the timeline;
        - 2 to 4: the measured angle; the angle predicted ``REPORTED_HORIZON`` s before; half width of its band, rad;
        - 5, 6: wind torque and half width of its band, rad/s²;
        - 7, 8: wind speed and half width of its band, m/s;
        - 9 to 13: roll, pitch, their setpoints, and yaw, rad;
        - 14 to 16: position north and east, and height, from the autopilot's origin of that boot, m;
        - 17 and on: output of each of the k ``motor_names``, as a fraction of its range.
        """
        width = COLUMNS_BEFORE_MOTORS + len(self.motor_names)
        rows = [row for row in self._rows if self.flight.contains(row[TIME_COLUMN])]
        table = np.full((len(rows), width), nan)
        for number, row in enumerate(rows):
            # Rows of a format with more or fewer motors than the latest one are cut, or filled up with NaN.
            values = row[:width]
            table[number, : len(values)] = values
        return table
