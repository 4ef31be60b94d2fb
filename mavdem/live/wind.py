"""The wind velocity of a live flight, m/s, estimated step by step from attitude and velocity over ground.

It is the extended Kalman filter of logs (``mavdem.wind_velocity.airflow_filter``) without its smoother, on a
grid of the same step, 0.5 s. An estimate is of the middle of two steps, 0.5 s before the velocity that completes it.
Drag and lean of the vehicle are those known beforehand. Filters with several sizes of gusts and noise run side by side,
and are weighted by how well they predicted so far.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import inf
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array
from mavdem.confidence import coverage_factor, half_width
from mavdem.dataset.axes import HORIZONTAL, YAW
from mavdem.dem.engine.linalg import normal_draws
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.identifiability import Status
from mavdem.facts.session import SessionFact
from mavdem.facts.wind import NoWind, WindDoubt, WindLight
from mavdem.ingest.telemetry import interpolated
from mavdem.live.link import SILENCE_SECONDS
from mavdem.plant.online_wind_torque import FIRST_FIT_SECONDS
from mavdem.wind_velocity.airflow_filter import TOTAL_WIND_MATRIX, AirflowFilter
from mavdem.wind_velocity.beaufort import is_speed_known
from mavdem.wind_velocity.compass import HEADING_SD, compass_text, speed_and_direction
from mavdem.wind_velocity.drag_identification import (
    GUST_PRIOR_MEAN,
    GUST_PRIOR_SD,
    filter_parameters,
)
from mavdem.wind_velocity.from_log import VELOCITY_VALID_FLAG, horizontal_velocity_valid
from mavdem.wind_velocity.ground_motion import MAX_VELOCITY_GAP, VELOCITY_MESSAGES
from mavdem.wind_velocity.identifiability import MAX_DIRECTION_INTERVAL, speed_status
from mavdem.wind_velocity.mean_wind import MAX_DIRECTION_OF_WIND, lower_speed_bound
from mavdem.wind_velocity.motion_grid import GRID_STEP, motion_grid, validated_motion
from mavdem.wind_velocity.vehicle_drag import Drag

MIN_SAMPLE_STEP = 0.05
"""Time between two samples of attitude, or of velocity, that are kept, s: a choice, ten in a step of the grid."""

STAMP_TOLERANCE = 1e-3
"""How much shorter a step may be, s: the resolution of time stamps."""

KEPT_SECONDS = 2 * FIRST_FIT_SECONDS
"""Duration of attitude and velocity that is kept, s: twice that in which free flight is checked."""

MIN_CHECKED_SAMPLES = 10
"""Samples in which free flight is checked, at least: a choice."""

LIKELIHOOD_MEMORY_SECONDS = 300.0
"""Time over which the filters' likelihoods are forgotten, s: a choice; the size of gusts changes in minutes."""

DRAG_DRAWS = 16
"""Draws of drag and lean that filters run for: a choice of accuracy and computing time."""

MAX_SPEED = 100.0
"""Speed over ground of no multirotor, m/s: a message with more is damaged."""

MAX_DIRECTION_BAND = 180.0
"""Half width of the band of a direction, degrees, with which it says nothing: half a turn."""

PREFERRED_MESSAGE = "LOCAL_POSITION_NED"
"""Message whose velocity is used alone, while it comes: the others have the same, rounded to cm/s."""

GUST_PARAMETERS = np.log(
    list(
        product(
            # Standard deviation of gusts, m/s².
            [0.15, 0.6],
            # Their correlation time, s.
            [5.0],
            # Change of the mean wind in a second, m/s².
            [0.02, 0.06],
            # Measurement noise, m/s².
            [0.02, 0.06, 0.2],
        )
    )
)
"""(12, 4) Logarithms of the gust and noise parameters that filters run for, in the order of ``GUST_PRIOR_MEAN``.

Two or three values of a parameter span what its prior makes likely.
"""


class CompassWind(NamedTuple):
    """Speed of the wind and the direction that it comes from, with 90 % intervals."""

    speed: float
    """Speed, m/s."""

    speed_low: float
    """Lower end of the 90 % interval of the speed, m/s."""

    speed_high: float
    """Upper end of that interval, m/s."""

    direction: float
    """Where the wind comes from, degrees clockwise from north."""

    direction_half_width: float
    """Half width of its 90 % interval, degrees; 180 where the wind may come from anywhere."""


@dataclass(frozen=True, eq=False)
class WindEstimate:
    """The velocity of the wind at one time, north and east, with its 90 % interval."""

    time: float
    """Time, s of the boot clock."""

    velocity: Array
    """(2,) Velocity of the air towards north and east, m/s."""

    band: Array
    """(2,) Half widths of its 90 % interval, m/s."""

    was_direction_known: bool = False
    """Whether the direction of the flight's estimate before this one was known, so that it is kept for longer."""

    @cached_property
    def compass(self) -> CompassWind:
        """The estimate as speed, m/s, and direction that the wind comes from, degrees, with their 90 % intervals.

        An error of the autopilot's heading (standard deviation ``HEADING_SD``, degrees) turns the direction as much. It
        is independent of the error of the velocity, so that the half widths of their intervals add as root of the sum
        of squares.
        """
        # The function takes arrays over time, here of length 1.
        speeds, directions, speed_half_widths, direction_half_widths = speed_and_direction(
            self.velocity[None], self.band[None]
        )
        speed, speed_half_width = speeds[0], speed_half_widths[0]
        heading_half_width = coverage_factor() * HEADING_SD
        direction_half_width = np.hypot(direction_half_widths[0], heading_half_width)
        return CompassWind(
            speed,
            speed_low=max(speed - speed_half_width, 0.0),
            speed_high=speed + speed_half_width,
            direction=directions[0],
            direction_half_width=min(direction_half_width, MAX_DIRECTION_BAND),
        )

    @property
    def facts(self) -> Facts:
        """What the user gets: one fact on the wind's speed, m/s, and, if it is known, one on where it comes from.

        If the 90 % interval of the speed reaches down to calm, there may be no wind at all: the speed is None beside
        its interval. The direction is in degrees clockwise from north, and a point of the compass.
        """
        wind = self.compass
        speed_fact = Fact(
            SessionFact.WIND_SPEED,
            speed=wind.speed if self._lowest_speed else None,
            speed_interval=(self._lowest_speed, wind.speed_high),
            status=speed_status(wind.speed, wind.speed_low, wind.speed_high),
        )
        if not self.is_direction_known:
            return (speed_fact,)
        direction_fact = Fact(
            SessionFact.WIND_FROM,
            direction=wind.direction,
            point=compass_text(wind.direction),
            half_width=wind.direction_half_width,
        )
        return speed_fact, direction_fact

    @property
    def is_direction_known(self) -> bool:
        """Whether it is stated where the wind comes from.

        A direction becomes known when its interval is narrow and still air is unlikely: in still air it would be
        chance. Once known it stays so in the flight until its interval is so wide that still air is likely, by the
        limit for the wind of a log. A speed that varies about the limit of calm would else show and hide it in turn.
        """
        half_width = self.compass.direction_half_width
        if self.was_direction_known:
            return half_width <= MAX_DIRECTION_OF_WIND
        return half_width <= MAX_DIRECTION_INTERVAL and self._lowest_speed > 0.0

    @property
    def _lowest_speed(self) -> float:
        """The lower end of the speed's interval, m/s; 0 where still air is likely as well."""
        return lower_speed_bound(self.compass.speed_low, self.compass.speed_high)

    @property
    def light(self) -> Fact:
        """The status light of the wind, for a flight whose mean wind is this estimate, as a log of it is judged.

        It is a fact with the speed and its 90 % interval, m/s, and the direction that the wind comes from, degrees;
        None if that is not known. There are three cases by the interval of the speed, which follows from the force of
        the wind and from the vehicle's drag:

        - It is narrow: the wind is known, and the level is "good".
        - It is wide: the speed is known only roughly, and the level is "unknown".
        - It is very wide: the wind is not known, with the reason, which is the drag.
        """
        speed_fact, *direction_facts = self.facts
        low, high = speed_fact.figures["speed_interval"]
        # The drag is usually not measured, and an error of it scales (biases) the speed.
        reason_if_rough = Fact(
            WindDoubt.SPEED_UNSURE, status=Status.BIASED, low=low, high=high, by_drag=True
        )
        if speed_fact.figures["status"] is Status.NOT_IDENTIFIABLE:
            return Fact(WindLight.WIND_NOT_KNOWN, reason=reason_if_rough)
        direction = direction_facts[0].figures["direction"] if direction_facts else None
        is_speed_accurate = is_speed_known((low, high))
        return Fact(
            WindLight.WIND_BLEW,
            Level.GOOD if is_speed_accurate else Level.UNKNOWN,
            calm=not low,
            speed=self.compass.speed,
            low=low,
            high=high,
            direction=direction,
            # The share of the allowed lean that the wind takes is not known in flight.
            share=0.0,
            is_rough=not is_speed_accurate,
            reason=None if is_speed_accurate else reason_if_rough,
        )


class _Motion(NamedTuple):
    """Attitude and velocity over ground at the same T times."""

    time: Array
    """(T,) s of the boot clock."""

    attitude: Array
    """(T, 3) Roll, pitch and yaw, rad."""

    velocity: Array
    """(T, 3) Velocity over ground, north, east and down, m/s."""


class _AttitudeSample(NamedTuple):
    """An attitude of free flight."""

    time: float
    """Time on the boot clock, s."""

    roll: float
    """rad."""

    pitch: float
    """rad."""

    yaw: float
    """rad."""


class _VelocitySample(NamedTuple):
    """A velocity over ground."""

    time: float
    """Time on the boot clock, s."""

    north: float
    """m/s."""

    east: float
    """m/s."""

    down: float
    """m/s."""


class LiveWind:
    """Estimates the wind of a live flight step by step, by Kalman filters of the airflow that run side by side.

    Attributes:
        earlier_drag: drag of the vehicle from an earlier flight; None if there is none.
        parameter_drag: drag by the autopilot's parameters, or of multirotors in general; used without an earlier one.
        estimator_flags: flags of the autopilot's estimator, by which its velocity counts.
        latest: the latest estimate; None before any.
        mean: mean of the flight's estimates, and of their bands, without those of motion that turned out not to be
            free; None before any.
        no_estimate_reason: why there is no estimate although the vehicle flies; the mean is then of the time before.
    """

    def __init__(self) -> None:
        self.earlier_drag: Drag | None = None
        self.parameter_drag = Drag.from_parameters()
        self.estimator_flags = VELOCITY_VALID_FLAG
        self.restart()

    def restart(self) -> None:
        """Forgets samples, filter and estimates: another flight begins, or the vehicle's clock begins again.

        What is known of the vehicle's drag, and the flags of the autopilot's estimator, stay. The attributes that it
        sets are created here, since the constructor calls it, too.
        """
        self.latest: WindEstimate | None = None
        self.mean: WindEstimate | None = None
        self.no_estimate_reason: Fact | None = None
        self._estimate_count = 0
        # The mean of the estimates, and their number, until free flight was checked last with success.
        self._checked_mean: WindEstimate | None = None
        self._checked_count = 0
        self._is_first_estimate_reported = False
        sample_count = round(KEPT_SECONDS / MIN_SAMPLE_STEP)
        self._attitudes = deque[_AttitudeSample](maxlen=sample_count)
        self._velocities = deque[_VelocitySample](maxlen=sample_count)
        self._filter: AirflowFilter | None = None
        self._step = GRID_STEP
        # Times of the boot clock, s: when a velocity was used last, when the preferred message came last, when the next
        # step of the filter ends, and when free flight is checked next.
        self._used_velocity_time = -inf
        self._preferred_message_time = -inf
        self._next_step_end = inf
        self._next_check_time = -inf

    def stop(self) -> None:
        """Ends the estimates of a flight that was lost: a falling vehicle does not lean into the wind.

        The mean stays, since its estimates are from before the loss.
        """
        self.latest = None
        self._filter = None
        self._attitudes.clear()
        self._velocities.clear()

    def add_attitude(self, time: float, roll: float, pitch: float, yaw: float) -> None:
        """Adds an attitude of free flight, unless it comes sooner than ``MIN_SAMPLE_STEP`` after the last one.

        The wind changes slowly, so that more attitudes would only cost memory and time.

        Args:
            time: time on the boot clock, s.
            roll: rad.
            pitch: rad.
            yaw: rad.
        """
        # Time stamps jitter, so that a step may be a little shorter.
        min_step = MIN_SAMPLE_STEP - STAMP_TOLERANCE
        follows_too_soon = bool(self._attitudes) and time - self._attitudes[-1].time < min_step
        if not follows_too_soon:
            self._attitudes.append(_AttitudeSample(time, roll, pitch, yaw))

    def add_velocity(self, name: str, time: float, values: Sequence[float]) -> Fact | None:
        """Adds a measured velocity, and estimates the wind from it and the lean of the vehicle.

        The estimate is made by a filter with steps of equal duration, so that one velocity may complete several steps
        or none. The filter begins when the vehicle flies freely, which is checked every ``FIRST_FIT_SECONDS``.

        A velocity is ignored if it comes too soon after the last one or another message has a better one, if it is not
        credible, or if no attitude has come yet.

        Args:
            name: name of the message, one of ``VELOCITY_MESSAGES``.
            time: time on the boot clock, s.
            values: velocity down, north and east in the unit of the message.

        Returns:
            The report that the wind is known, with the flight's first useful estimate; None otherwise.
        """
        is_selected = self._selects_velocity(name, time)
        # The factor converts the unit of the message, such as cm/s, to m/s.
        factor = VELOCITY_MESSAGES[name]
        down, north, east = (factor * value for value in values)
        velocity = _VelocitySample(time, north, east, down)
        has_attitude = bool(self._attitudes)
        if not is_selected or not has_attitude or not self._is_credible(velocity):
            return None
        if self._velocities and time - self._velocities[-1].time > SILENCE_SECONDS:
            self._end_filter_after_silence(time)
        self._velocities.append(velocity)
        if time >= self._next_check_time:
            self._next_check_time = time + FIRST_FIT_SECONDS
            self._check_free_flight(time)
        self._estimate_complete_steps(time)
        return self._report_on_first_estimate()

    def _report_on_first_estimate(self) -> Fact | None:
        """Returns the report that the wind is known, once in a flight; None before that, and later.

        An estimate whose speed is not identifiable, such as 0 to 11 m/s, tells a pilot nothing, and is not reported.
        """
        if self.latest is None or self._is_first_estimate_reported:
            return None
        speed_fact, *_ = self.latest.facts
        if speed_fact.figures["status"] is Status.NOT_IDENTIFIABLE:
            return None
        self._is_first_estimate_reported = True
        return Fact(SessionFact.WIND_KNOWN, reason=self.latest.facts)

    def _is_credible(self, velocity: _VelocitySample) -> bool:
        """Returns whether a velocity is possible, by ``MAX_SPEED``, and valid by the flags of the estimator."""
        components = (velocity.north, velocity.east, velocity.down)
        is_possible = all(abs(component) < MAX_SPEED for component in components)
        return is_possible and horizontal_velocity_valid(self.estimator_flags)

    def _end_filter_after_silence(self, time: float) -> None:
        """Ends the filter after a silence, in which the wind may have changed.

        It begins again with the next check of free flight, once there are enough samples for it.

        Args:
            time: time of the first velocity after the silence, s of the boot clock.
        """
        self._filter = None
        self.latest = None
        self._next_check_time = time + FIRST_FIT_SECONDS

    def _estimate_complete_steps(self, time: float) -> None:
        """Estimates the wind at the steps of the filter that both velocity and attitude have reached.

        The attitude may be one sample behind the velocity.

        Args:
            time: time of the latest velocity, s of the boot clock.
        """
        attitude_time = self._attitudes[-1].time
        reached_time = min(time, attitude_time + MIN_SAMPLE_STEP)
        while self._next_step_end <= reached_time:
            self._estimate_step(self._next_step_end)
            self._next_step_end += self._step

    def _selects_velocity(self, name: str, time: float) -> bool:
        """Returns whether a velocity is to be used, by its message and its time, and stores the time if so.

        Several messages carry the same velocity, and all but the preferred one round it. The others are used only while
        the preferred one does not come. A velocity less than ``MIN_SAMPLE_STEP`` after the last one is not needed.

        Args:
            name: name of the message, one of ``VELOCITY_MESSAGES``.
            time: time on the boot clock, s.
        """
        if name == PREFERRED_MESSAGE:
            self._preferred_message_time = time
        else:
            is_preferred_received = time - self._preferred_message_time < SILENCE_SECONDS
            if is_preferred_received:
                return False
        # Time stamps jitter, so that a step may be a little shorter.
        min_step = MIN_SAMPLE_STEP - STAMP_TOLERANCE
        if time - self._used_velocity_time < min_step:
            return False
        self._used_velocity_time = time
        return True

    def _motion(self, start_time: float, end_time: float) -> _Motion:
        """Joins attitude and velocity between two times: velocities are interpolated at the stamps of the attitudes.

        Attitudes before the first and after the last velocity, or in a gap of velocities longer than
        ``MAX_VELOCITY_GAP``, are left out, as they are for a recorded flight.

        Args:
            start_time: first time, s of the boot clock.
            end_time: s; attitudes at this time are left out.

        Returns:
            Times, attitudes and velocities of N samples.
        """
        attitude_samples = [
            sample for sample in self._attitudes if start_time <= sample.time < end_time
        ]
        first_velocity_time = start_time - MAX_VELOCITY_GAP
        velocity_samples = [
            sample for sample in self._velocities if sample.time >= first_velocity_time
        ]
        # Tables (N, 4) with a row for each sample: its time, and three angles or velocities. They may have no rows.
        attitudes = np.array(attitude_samples).reshape(-1, 4)
        velocities = np.array(velocity_samples).reshape(-1, 4)
        velocity_times = velocities[:, 0]
        # Index of the first velocity that is not earlier than each attitude. With velocities at 0.0, 0.2 and 0.4 s and
        # an attitude at 0.3 s it is 2, and the attitude is between velocities 1 and 2.
        next_velocity = np.searchsorted(velocity_times, attitudes[:, 0])
        is_between_velocities = (next_velocity > 0) & (next_velocity < len(velocities))
        attitudes = attitudes[is_between_velocities]
        next_velocity = next_velocity[is_between_velocities]
        gaps = velocity_times[next_velocity] - velocity_times[next_velocity - 1]
        attitudes = attitudes[gaps <= MAX_VELOCITY_GAP]
        time = attitudes[:, 0]
        velocity = interpolated(time, velocity_times, velocities[:, 1:])
        return _Motion(time, attitudes[:, 1:], velocity)

    def _check_free_flight(self, time: float) -> None:
        """Begins the filter where the vehicle flies freely, or ends it where its motion shows that it does not.

        A vehicle that is held, on a stand for example, does not lean against the wind, so that no wind can be
        estimated. This is judged by the motion of the last ``FIRST_FIT_SECONDS``, by the rules for logs
        (``validated_motion``). If it has too few samples, it is judged again a step later. If it fails, the estimates
        since the last check with success were of no wind, and are forgotten; ``no_estimate_reason`` says why.

        Args:
            time: time of the latest velocity, s of the boot clock.
        """
        motion = self._motion(time - FIRST_FIT_SECONDS, time)
        stamps = motion.time
        has_too_few_samples = len(stamps) < MIN_CHECKED_SAMPLES
        if has_too_few_samples or stamps[-1] - stamps[0] < FIRST_FIT_SECONDS / 2:
            self._next_check_time = time + self._step
            return
        try:
            self._require_measurements(motion)
            validated_motion(stamps, motion.attitude, motion.velocity)
        except NotLearnable as error:
            self._withdraw_unchecked_estimates(error.fact)
            return
        self.no_estimate_reason = None
        self._checked_mean = self.mean
        self._checked_count = self._estimate_count
        if self._filter is None:
            self._begin_filter(motion, time)

    def _begin_filter(self, motion: _Motion, time: float) -> None:
        """Begins the filter with the step and the mean motion of the last seconds, unless no step is complete in them.

        Args:
            motion: attitude and velocity over ground of the last seconds, in which the vehicle flew freely.
            time: time of the latest velocity, s of the boot clock; the first step of the filter ends with it.
        """
        step = max(GRID_STEP, np.median(np.diff(motion.time)))
        grid = motion_grid(motion.time, motion.attitude, motion.velocity, step)
        if not grid.complete.any():
            return
        self._step = grid.step
        self._filter = AirflowFilter(filter_parameters(self._parameter_draws(), grid), grid)
        self._next_step_end = time

    def _withdraw_unchecked_estimates(self, reason: Fact) -> None:
        """Ends the estimation, and takes back the estimates since the last check that the vehicle flew freely.

        Args:
            reason: why the motion shows no wind, such as that the vehicle is held.
        """
        self.no_estimate_reason = reason
        self.latest = None
        # The mean over all estimates, and their number, become those at that check.
        self.mean = self._checked_mean
        self._estimate_count = self._checked_count
        # A new filter begins when the vehicle flies freely again.
        self._filter = None

    def _parameter_draws(self) -> Array:
        """Returns the parameters of the filters that run side by side, one row for each.

        The drag of the vehicle is known only as a normal distribution: from earlier flights, or else from the
        autopilot's parameters. ``DRAG_DRAWS`` random values are drawn of it, so that the spread of the filters'
        estimates shows how well it is known. Each draw is combined with each row of ``GUST_PARAMETERS``, which has the
        size and duration of gusts and the noise. The seed is fixed, so that equal flights give equal results.

        Returns:
            (12 · 16, 6 + 4): in each row six values of a draw (drag and lean), then the four of a row of gusts and
            noise. All 16 draws come with the first row of gusts and noise, then all with the second, and so on.
        """
        drag = self.earlier_drag or self.parameter_drag
        drags = normal_draws(drag.mean, drag.covariance, DRAG_DRAWS, seed=1)
        drag_columns = np.tile(drags, (len(GUST_PARAMETERS), 1))
        gust_columns = np.repeat(GUST_PARAMETERS, DRAG_DRAWS, axis=0)
        return np.hstack([drag_columns, gust_columns])

    @staticmethod
    def _require_measurements(motion: _Motion) -> None:
        """Checks that yaw and horizontal velocity are measured: that they change at all.

        Measured values always have some noise. An autopilot sends a constant, mostly 0, for a quantity that it does not
        measure.

        Args:
            motion: attitude and velocity over ground, from which the wind is to be estimated.

        Raises:
            NotLearnable: one of them is constant.
        """
        yaw_is_constant = np.ptp(motion.attitude[:, YAW]) == 0
        velocity_is_constant = (np.ptp(motion.velocity[:, HORIZONTAL], axis=0) == 0).any()
        if yaw_is_constant:
            raise NotLearnable(NoWind.NOT_MEASURED, name="yaw")
        if velocity_is_constant:
            raise NotLearnable(NoWind.NOT_MEASURED, name="velocity")

    def _estimate_step(self, end_time: float) -> None:
        """Advances the filters by one step, and updates ``latest`` and ``mean`` by the average of their winds.

        Args:
            end_time: end of the step, s of the boot clock. The measurement, and the estimate, are of the middle of the
                last two steps, ``_step`` before it.
        """
        filters = self._filter
        if filters is None:
            return
        filters.predict()
        motion = self._motion(end_time - 2 * self._step, end_time)
        if len(motion.time) > 2:
            grid = motion_grid(motion.time, motion.attitude, motion.velocity, self._step)
            # The first point of the grid is the middle of the two steps; a gap may leave none.
            is_first_point_complete = grid.complete[:1].any()
            if is_first_point_complete:
                filters.update(grid, 0)
                # Exponential forgetting of the likelihood.
                filters.log_likelihoods *= 1 - self._step / LIKELIHOOD_MEMORY_SECONDS

        was_direction_known = self.latest is not None and self.latest.is_direction_known
        estimate = _averaged_wind(filters, end_time - self._step)
        self.latest = replace(estimate, was_direction_known=was_direction_known)
        self._update_mean(self.latest)

    def _update_mean(self, estimate: WindEstimate) -> None:
        """Adds an estimate to the running mean of the flight.

        The 90 % band of the mean is the mean of the bands, and does not shrink with the number of estimates: errors of
        the drag and of the level are the same in all of them, so that the mean is no more certain than one estimate.

        Args:
            estimate: the latest estimate of the wind, with its 90 % interval.
        """
        self._estimate_count += 1
        # The first estimate is its own mean.
        mean = self.mean or estimate
        velocity = mean.velocity + (estimate.velocity - mean.velocity) / self._estimate_count
        band = mean.band + (estimate.band - mean.band) / self._estimate_count
        self.mean = WindEstimate(estimate.time, velocity, band, mean.is_direction_known)


def _averaged_wind(filters: AirflowFilter, time: float) -> WindEstimate:
    """Returns the wind by all filters, weighted by their likelihood (Bayesian model averaging).

    Each filter gives a normal distribution of the wind, north and east. The mean of their weighted mixture is the
    weighted mean. Its variance is the mean variance within the filters plus the variance between them.

    Args:
        filters: G filters that run side by side, with states, covariances and log likelihoods.
        time: time of the estimate, s of the boot clock.
    """
    weights = _filter_weights(filters.log_likelihoods)
    winds = filters.states @ TOTAL_WIND_MATRIX.T
    # Letters of einsum: filter g, axis a of the wind, states i and j.
    variances_within = np.einsum(
        "ai,gij,aj->ga", TOTAL_WIND_MATRIX, filters.covariances, TOTAL_WIND_MATRIX
    )
    velocity = weights @ winds
    variance = weights @ (variances_within + (winds - velocity) ** 2)
    return WindEstimate(time, velocity, half_width(variance))


def _filter_weights(log_likelihoods: Array) -> Array:
    """Returns the weight of each filter in the mean wind.

    There is a filter for each combination of a size of gusts and noise with a draw of the drag. The weight of a size is
    its prior, a normal distribution of the logarithms, times the likelihood of the innovations so far. All draws of the
    drag have equal weight within a size, since the drag is not learned from the flight.

    Args:
        log_likelihoods: (sizes · draws,) of the filters, the draws of one size after another.

    Returns:
        Weights (sizes · draws,), which sum to 1.
    """
    # The likelihood of a size is that of its draws of the drag: the mean of their log likelihoods.
    log_likelihood_of_size = log_likelihoods.reshape(len(GUST_PARAMETERS), -1).mean(axis=1)
    # The log density of a normal distribution is minus half of the squared distance.
    prior_distances = (GUST_PARAMETERS - GUST_PRIOR_MEAN) / GUST_PRIOR_SD
    log_prior = -(prior_distances**2).sum(axis=1) / 2
    weight_of_size = scipy.special.softmax(log_likelihood_of_size + log_prior)
    return np.repeat(weight_of_size / DRAG_DRAWS, DRAG_DRAWS)
