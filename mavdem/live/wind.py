"""The wind in metres a second over a link.

It is the filter that is smoothed offline, on a grid of the same step, 0.5 s. A row is of the middle of two steps,
0.5 s before the velocity that completes it. Drag and lean are those known beforehand; sizes of gusts and noise are
weighed by how well they predicted so far.
"""

from collections import deque
from collections.abc import Sequence
from itertools import product
from math import inf
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from mavdem.arrays import Array
from mavdem.confidence import coverage_factor, half_width
from mavdem.containers import Numbers
from mavdem.dem.engine.linalg import normal_draws
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts
from mavdem.facts.identifiability import Status
from mavdem.facts.session import Session
from mavdem.facts.wind import NoWind, WindDoubt, WindLight
from mavdem.ingest.telemetry import interpolated
from mavdem.live.link import SILENCE_SECONDS
from mavdem.plant.online_wind_torque import FIRST_FIT_SECONDS
from mavdem.wind_velocity.airflow_filter import TOTAL_WIND_MATRIX, AirflowFilter
from mavdem.wind_velocity.compass import compass_text, speed_and_direction
from mavdem.wind_velocity.drag_identification import (
    GUST_PRIOR_MEAN,
    GUST_PRIOR_SD,
    filter_parameters,
)
from mavdem.wind_velocity.estimation import (
    HEADING_SD,
    MAX_DIRECTION_INTERVAL,
    lower_speed_bound,
    speed_status,
)
from mavdem.wind_velocity.from_log import (
    MAX_VELOCITY_GAP,
    VELOCITY_MESSAGES,
    VELOCITY_VALID_FLAG,
    horizontal_velocity_valid,
)
from mavdem.wind_velocity.motion_grid import GRID_STEP, motion_grid, validated_motion
from mavdem.wind_velocity.vehicle_drag import Drag

SAMPLE_SECONDS = 0.05  # s between samples that are kept, at least
MEMORY = 300.0  # s, of weighing sizes of gusts
# of drag and lean; m/s: what is faster is damaged
WIND_DRAWS = 16
DAMAGED_SPEED = 100.0
SIZES = np.log(
    [*product([0.15, 0.6], [5.0], [0.02, 0.06], [0.02, 0.06, 0.2])]
)  # as GUST_PRIOR_MEAN


class WindEstimate(NamedTuple):
    """The wind at ``time``, s of the boot clock: north and east of where the air moves to, m/s, with half widths."""

    time: float
    velocity: Array  # (2,)
    band: Array  # (2,), which holds it with 90 %

    @property
    def by_compass(self) -> Numbers:
        """Speed and the ends of its interval, m/s; the direction it comes from and its half width, degrees."""
        speed, origin, half, turned = (
            figure[0] for figure in speed_and_direction(self.velocity[None], self.band[None])
        )
        turned = min(np.hypot(turned, coverage_factor() * HEADING_SD), 180.0)
        return speed, max(speed - half, 0.0), speed + half, origin, turned

    @property
    def facts(self) -> Facts:
        """The speed, which is None where it may be calm, and where the wind comes from as far as that is known."""
        speed, low, high, origin, turned = self.by_compass
        status = speed_status(speed, low, high)
        low = lower_speed_bound(low, high)
        strength = Fact(
            Session.WIND_SPEED,
            speed=speed if low else None,
            speed_interval=(low, high),
            status=status,
        )
        if not low or turned > MAX_DIRECTION_INTERVAL:
            return (strength,)
        course = Fact(
            Session.WIND_FROM,
            direction=origin,
            point=compass_text(origin),
            half_width=turned,
        )
        return strength, course

    @property
    def light(self) -> Fact:
        """What the light of a flight says whose mean this is."""
        strength, *course = self.facts
        status = strength.figures["status"]
        low, high = strength.figures["speed_interval"]
        if status is Status.NOT_IDENTIFIABLE:
            # Of a drag that no flight has measured, as a rule
            unsure = Fact(
                WindDoubt.SPEED_UNSURE, status=Status.BIASED, low=low, high=high, by_drag=True
            )
            return Fact(WindLight.WIND_NOT_KNOWN, because=unsure)
        return Fact(
            WindLight.WIND_BLEW,
            calm=not low,
            speed=self.by_compass[0],
            low=low,
            high=high,
            direction=course[0].figures["direction"] if course else None,
            share=0.0,
        )


class LiveWind:
    """Makes rows of a flight's attitude and velocity: the latest ``row``, their ``mean``, or the ``obstacle``.

    The ``drag`` is from another flight, else ``set_drag`` by the parameters; ``flags`` are the estimator's.
    """

    drag: Drag | None = None
    flags = VELOCITY_VALID_FLAG

    def __init__(self) -> None:
        self.set_drag = Drag.from_parameters()
        self.restart()

    def restart(self) -> None:
        """Forgets the flight: another begins, or its clock is over."""
        self.row: WindEstimate | None = None
        self.mean: WindEstimate | None = None
        self.obstacle: Fact | None = None
        self._rows = 0  # in the mean
        self._said = False
        self._last = -inf
        kept = round(2 * FIRST_FIT_SECONDS / SAMPLE_SECONDS)
        self._attitudes = deque[Sequence[float]](maxlen=kept)
        self._velocities = deque[Sequence[float]](maxlen=kept)
        self._filter: AirflowFilter | None = None
        self._step = GRID_STEP
        self._end = inf  # s, of the step that comes next
        self._next_check = -inf
        self._local = -inf

    def attitude(self, time: float, angles: Sequence[float]) -> None:
        """Takes roll, pitch and yaw, rad."""
        if not self._attitudes or time - self._attitudes[-1][0] >= SAMPLE_SECONDS - 1e-3:
            self._attitudes.append((time, *angles))

    def velocity(self, name: str, time: float, values: Sequence[float]) -> Fact | None:
        """Takes down, north and east of a message; returns the wind with the first row."""
        self._local = time if name == "LOCAL_POSITION_NED" else self._local
        # Of several messages that one alone
        is_other = name != "LOCAL_POSITION_NED" and time - self._local < SILENCE_SECONDS
        if is_other or time - self._last < SAMPLE_SECONDS - 1e-3:
            return None
        self._last = time
        down, *level = (VELOCITY_MESSAGES[name] * value for value in values)
        sure = horizontal_velocity_valid(self.flags)
        if not (
            sure and self._attitudes and all(abs(part) < DAMAGED_SPEED for part in (down, *level))
        ):
            return None
        if self._velocities and time - self._velocities[-1][0] > SILENCE_SECONDS:
            self._filter = None
            self.row = None
            self._next_check = time + FIRST_FIT_SECONDS
        self._velocities.append((time, *level, down))
        if time >= self._next_check:
            self._next_check = time + FIRST_FIT_SECONDS
            self._check(time)
        while self._end <= min(time, self._attitudes[-1][0] + SAMPLE_SECONDS):
            self._take(self._end)
            self._end += self._step
        news = self.row is not None and not self._said
        self._said = self._said or self.row is not None
        if not news or self.row is None:
            return None
        return Fact(Session.WIND_KNOWN, because=self.row.facts)

    def _table(self, since: float, until: float) -> tuple[Array, Array, Array]:
        """Times (T,), attitudes (T, 3) and velocities (T, 3) between two times, as offline."""
        rows = np.array([row for row in self._attitudes if since <= row[0] < until]).reshape(-1, 4)
        velocities = np.array(
            [row for row in self._velocities if since - MAX_VELOCITY_GAP <= row[0]]
        ).reshape(-1, 4)
        after = np.searchsorted(velocities[:, 0], rows[:, 0])
        inside = (after > 0) & (after < len(velocities))
        rows = rows[inside]
        after = after[inside]
        rows = rows[velocities[after, 0] - velocities[after - 1, 0] <= MAX_VELOCITY_GAP]
        moved = interpolated(rows[:, 0], velocities[:, 0], velocities[:, 1:])
        return rows[:, 0], rows[:, 1:], moved

    def _check(self, time: float) -> None:
        """Ends where the vehicle does not fly freely, and begins where it does."""
        stamps, angles, speeds = self._table(time - FIRST_FIT_SECONDS, time)
        if len(stamps) < 10 or stamps[-1] - stamps[0] < FIRST_FIT_SECONDS / 2:
            self._next_check = time + self._step
            return
        try:
            still = [np.ptp(angles[:, 2]), *np.ptp(speeds[:, :2], axis=0)]
            if 0 in still:
                raise NotLearnable(NoWind.NOT_MEASURED, name="velocity" if still[0] else "yaw")
            validated_motion(stamps, angles, speeds)
        except NotLearnable as error:
            self.obstacle = error.fact
            self.row = self.mean = None
            self._rows = 0
            self._filter = None
            return
        self.obstacle = None
        start = motion_grid(stamps, angles, speeds, max(GRID_STEP, np.median(np.diff(stamps))))
        if self._filter is None and start.complete.any():
            self._step = start.step
            drag = self.drag or self.set_drag
            places = normal_draws(drag.mean, drag.covariance, WIND_DRAWS, seed=1)
            places = np.hstack(
                [np.tile(places, (len(SIZES), 1)), np.repeat(SIZES, WIND_DRAWS, axis=0)]
            )
            self._filter = AirflowFilter(filter_parameters(places, start), start)
            self._end = time

    def _take(self, end: float) -> None:
        """Goes on by a step that ends at ``end``."""
        run = self._filter
        if run is None:
            return
        run.predict()
        stamps, angles, speeds = self._table(end - 2 * self._step, end)
        moved = motion_grid(stamps, angles, speeds, self._step) if len(stamps) > 2 else None
        if moved is not None and moved.complete[:1].any():
            run.update(moved, 0)
            run.log_likelihoods *= 1 - self._step / MEMORY
        logs = (
            run.log_likelihoods.reshape(len(SIZES), -1).mean(axis=1)
            - (((SIZES - GUST_PRIOR_MEAN) / GUST_PRIOR_SD) ** 2).sum(axis=1) / 2
        )
        weights = np.repeat(softmax(logs) / WIND_DRAWS, WIND_DRAWS)
        winds = run.states @ TOTAL_WIND_MATRIX.T
        variances = np.einsum(
            "ai,gij,aj->ga", TOTAL_WIND_MATRIX, run.covariances, TOTAL_WIND_MATRIX
        )
        mean = weights @ winds
        band = half_width(weights @ (variances + (winds - mean) ** 2))
        self.row = row = WindEstimate(end - self._step, mean, band)
        # Drag and lean err alike in all rows, so the mean is known no better than they are.
        self._rows += 1
        before = self.mean or row
        parts = (
            old + (new - old) / self._rows for old, new in zip(before[1:], row[1:], strict=True)
        )
        self.mean = WindEstimate(row.time, *parts)
