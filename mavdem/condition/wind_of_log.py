"""The wind in metres a second in a recorded flight and over a link: which messages say it, and which parts of it count.

Live, the filter that is smoothed offline runs on grids of the same step, 0.5 s, that begin a tenth of a second apart: a
row is a step of one of them. It is of the middle of two steps, 0.5 s before the velocity that completes it. Drag and
lean are those known beforehand; sizes of gusts and noise are weighed by how well they predicted so far.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from math import ceil, inf
from os import PathLike
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment import phases
from mavdem.alignment.drive import AXES, Signal, floats
from mavdem.alignment.read import choose_vehicle
from mavdem.alignment.signals import Signals, attitude
from mavdem.condition.wind_velocity import (
    CALM,
    DIRECTION_LIMIT,
    HEADING_SD,
    WindVelocity,
    by_compass,
    estimate_wind,
    from_point,
)
from mavdem.confidence import quantile
from mavdem.dem.airflow.identification import GUSTS, GUSTS_SD, STEP, checked, in_air
from mavdem.dem.airflow.model import TOTAL, Drag, Filter, drawn, motion
from mavdem.errors import NotLearnable
from mavdem.ingest import read_log
from mavdem.ingest.telemetry import Array, Columns, rows_by

VELOCITIES = {"LOCAL_POSITION_NED": 1.0, "GLOBAL_POSITION_INT": 0.01}
"""Messages with the velocity over ground, the preferred first, and the factor that makes it m/s."""
FLAGS, VELOCITY_FLAGS = ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS"), (2, 128)
"""Messages with the estimator's flags: that it knows the horizontal velocity, and that it assumes to stand still."""
VELOCITY_JUMP, YAW_JUMP = (1.0, 15.0), (0.35, 6.0)
"""m/s, rad, and m/s², rad/s: a change beyond both is a reset. Before one of the yaw it was not known."""
POSITION_JUMP, AROUND = 1.0, 1.5  # m beyond what the velocity covers, of a reset; s around it that are left out
LOWEST_FLIGHT, LONGEST_STEP = 1.5, 1.5  # m above the lowest height, without motors; s between velocities
ROW, SAMPLE = 0.1, 0.05  # s from row to row, and between samples that are kept, at least
START, LOST, MEMORY = 8.0, 3.0, 300.0  # s: of free flight before a row, without velocity, of weighing sizes of gusts
DRAWS, FASTEST = 16, 100.0  # of drag and lean; m/s: what is faster is damaged
SIZES = np.log([*product([0.15, 0.6], [5.0], [0.02, 0.06], [0.02, 0.06, 0.2])])  # as GUSTS
Air = tuple[WindVelocity | None, Signal | None, str]  # the wind, the autopilot's own estimate, and why there is no wind


def wind(path: str | bytes | PathLike[str], vehicle: str | None = None, drag: Drag | None = None) -> WindVelocity:
    """Returns the wind of a log's longest flight, from attitude and velocity over ground at 1 Hz and faster.

    Args:
        path: a log that ``mavdem.ingest.read_log`` reads.
        vehicle: "system" or "system:component", where the log holds several.
        drag: of the vehicle; the autopilot's own coefficients, where somebody set them, unless given.

    Raises:
        Unreadable: the log cannot be read.
        NotLearnable: it holds no vehicle, no velocity, no yaw or no flight, or no free one.
    """
    return wind_of(Signals(choose_vehicle(read_log(path).vehicles, vehicle)), drag)


def wind_of(signals: Signals, drag: Drag | None = None) -> WindVelocity:
    """Returns the wind of a vehicle's ``signals``, as :func:`wind` does, with the ``drag`` of before."""
    telemetry = signals.telemetry
    angles = [found for axis in AXES if (found := attitude(telemetry, axis)) is not None]
    name = next((name for name in VELOCITIES if len(telemetry.messages.get(name, {}).get("vx", ())) > 1), "")
    if len(angles) < len(AXES) or not name:
        ask = "Ask for ATTITUDE and LOCAL_POSITION_NED at 5 Hz or more; log XKF1, or vehicle_local_position in ULog."
        missing = "velocity over ground" if len(angles) == len(AXES) else "attitude"
        raise NotLearnable(f"The {missing} was not recorded, and without it there is no wind.", ask)
    columns, factor = telemetry.messages[name], VELOCITIES[name]
    moving = factor * np.column_stack([floats(columns, field) for field in ("vx", "vy", "vz")])
    above = -floats(columns, "z") if factor == 1 else floats(columns, "relative_alt") / 1000
    best, best_boot = np.zeros((0, 8)), 0
    for boot, rows in rows_by(columns["boot"]).items():
        time, first = np.unique(columns["time"][rows], return_index=True)
        velocity, height = moving[rows[first]], above[rows[first]]
        at, one = np.unique(angles[0].time[angles[0].boot == boot], return_index=True)
        if len(time) < 2:
            continue
        sure = _known(signals, boot, columns, rows[first], velocity)
        kept = phases.during(at, _flights(signals, boot, time, height)) & (at >= time[0]) & (at <= time[-1])
        after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
        kept &= sure[after] & sure[after - 1] & (time[after] - time[after - 1] <= LONGEST_STEP)
        turned = [angle.angle[angle.boot == boot][one] for angle in angles]
        kept &= at > np.max(at[1:][_jumps(at, turned[2] % (2 * np.pi), YAW_JUMP, 2 * np.pi)], initial=-np.inf) + AROUND
        moved = [np.interp(at, time, column) for column in (*velocity.T, height)]
        found = np.column_stack([at, *turned, *moved])[kept]
        best, best_boot = (found, int(boot)) if len(found) > len(best) else (best, best_boot)
    if len(best) < 10:
        raise NotLearnable("There is no settled flight with a velocity: on the ground, in climbs, or without position.")
    if 0 in (still := np.ptp(best[:, 3:5], axis=0)):
        raise NotLearnable(f"The {'velocity' if still[0] else 'yaw'} never changes by a digit: it is not measured.")
    drag = Drag.of_parameters(telemetry.autopilot, telemetry.parameters) if drag is None else drag
    return replace(estimate_wind(best[:, 0], best[:, 1:4], best[:, 4:7], drag, best[:, 7]), boot=best_boot)


def air_of(signals: Signals) -> Air:
    """Returns what a vehicle's ``signals`` say of the wind."""
    try:
        return wind_of(signals), signals.autopilot_wind, ""
    except NotLearnable as error:
        return None, None, str(error)


def _flights(signals: Signals, boot: int, time: Array, height: Array) -> phases.Intervals:
    """Settled flight; where neither motors nor landed state were recorded, armed flight above the ground."""
    if signals.collective is not None or signals.landed_state is not None:
        return phases.settled(signals, boot)
    up = phases.both(phases.armed(signals, boot), phases.where(time, height > np.nanmin(height) + LOWEST_FLIGHT))
    return [flight for one in up if (flight := phases.between_transients(one, None)) is not None]


def _known(signals: Signals, boot: int, columns: Columns, rows: NDArray[np.intp], velocity: Array) -> NDArray[np.bool_]:
    """(N,) where the estimator knows the velocity, without what surrounds a reset of the position."""
    time, sure = columns["time"][rows], np.isfinite(velocity).all(axis=1)
    sure &= columns["valid"][rows] if "valid" in columns else True
    if "x" in columns:
        steps = np.diff(np.column_stack([floats(columns, axis)[rows] for axis in "xy"]), axis=0)
        covered = (velocity[1:, :2] + velocity[:-1, :2]) / 2 * np.diff(time)[:, None]
        jumps = np.abs(steps - covered).max(axis=1) > POSITION_JUMP + 2 * np.diff(time)
        sure &= ~phases.during(time, [(t - AROUND, t + AROUND) for t in time[1:][jumps]])
    for speed in velocity[:, :2].T:
        reset = time[1:][_jumps(time, speed, VELOCITY_JUMP)]
        sure &= ~phases.during(time, [(t - AROUND, t + AROUND) for t in reset])
    for flags in (signals.telemetry.messages[name] for name in FLAGS if name in signals.telemetry.messages):
        if np.any(here := flags["boot"] == boot):
            lost = flags["flags"][here].astype(np.int64) & sum(VELOCITY_FLAGS) != VELOCITY_FLAGS[0]
            sure &= np.interp(time, flags["time"][here], lost) == 0
    return np.asarray(sure)


def _jumps(time: Array, values: Array, limits: tuple[float, float], turn: float = np.inf) -> NDArray[np.bool_]:
    """(N - 1,) where ``values`` change by more than the first of ``limits`` and the second a second."""
    steps = np.abs(np.diff(values))
    return np.asarray(np.minimum(steps, turn - steps) > limits[0] + limits[1] * np.diff(time))


class WindRow(NamedTuple):
    """The wind at ``time``, s of the boot clock: north and east of where the air moves to, m/s, with half widths."""

    time: float
    velocity: Array  # (2,)
    band: Array  # (2,), which holds it with 90 %

    @property
    def by_compass(self) -> tuple[float, float, float, float, float]:
        """Speed and the ends of its interval, m/s; the direction it comes from and its half width, degrees."""
        speed, origin, half, turned = (float(one[0]) for one in by_compass(self.velocity[None], self.band[None]))
        turned = min(float(np.hypot(turned, quantile() * HEADING_SD)), 180.0)
        return speed, max(speed - half, 0.0), speed + half, origin, turned

    def words(self) -> tuple[str, str]:
        """Returns the speed with its interval, and where it comes from as far as that is known."""
        speed, low, high, origin, turned = self.by_compass
        if low < min(CALM, high / 3):
            return f"below {high:.1f} m/s", ""
        said = f" from {from_point(origin)}, ± {turned:.0f}°" if turned <= DIRECTION_LIMIT else ""
        return f"{speed:.1f} m/s ({low:.1f} to {high:.1f})", said


class LiveWind:
    """Makes rows of attitude and velocity in settled flight: the latest ``row``, or the ``reason`` why there is none.

    The ``drag`` is from another flight, else ``set_drag`` by the parameters; ``flags`` are the estimator's.
    """

    drag: Drag | None = None

    def __init__(self) -> None:
        self.set_drag = Drag.of_parameters()
        self.restart()

    def restart(self) -> None:
        """Forgets the flight, whose clock is over."""
        self.row: WindRow | None = None
        self.reason, self.flags, self._said = "", VELOCITY_FLAGS[0], False
        self._last: tuple[float, Sequence[float], Sequence[float]] = -inf, (), ()
        self._attitudes, self._velocities = (deque[Sequence[float]](maxlen=round(2 * START / SAMPLE)) for _ in "av")
        self._filters: list[Filter] = []
        self._tick, self._step, self._next_check, self._local, self._ignored = 0, STEP, -inf, -inf, -inf

    def attitude(self, time: float, angles: Sequence[float]) -> None:
        """Takes roll, pitch and yaw, rad."""
        if not self._attitudes or time - self._attitudes[-1][0] >= SAMPLE - 1e-3:
            self._attitudes.append((time, *angles))

    def velocity(self, name: str, time: float, values: Sequence[float]) -> str:
        """Takes down, north and east of a message, and where that is; returns a sentence on the first row."""
        (last, moved, place), self._local = self._last, time if name == "LOCAL_POSITION_NED" else self._local
        dt = time - last
        if dt < SAMPLE - 1e-3 or (name != "LOCAL_POSITION_NED" and time - self._local < LOST):
            return ""
        down, *level = (VELOCITIES[name] * value for value in values[:3])
        self._last = time, level, values[3:]
        # A reset of the position is no motion.
        both = zip(values[3:], place, level, moved, strict=False)
        if any(abs(now - then - (a + b) * dt / 2) > POSITION_JUMP + 2 * dt for now, then, a, b in both):
            self._ignored = time + AROUND
        sure = self.flags & sum(VELOCITY_FLAGS) == VELOCITY_FLAGS[0] and time >= self._ignored
        if not (sure and self._attitudes and all(abs(part) < FASTEST for part in (down, *level))):
            return ""
        if self._velocities and time - self._velocities[-1][0] > LOST:
            self._filters, self.row, self._next_check = [], None, time + START
        self._velocities.append((time, *level, down))
        if time >= self._next_check:
            self._next_check = time + START
            self._check(time)
        while self._filters and (end := self._tick * ROW) <= min(time, self._attitudes[-1][0] + SAMPLE):
            self._take(self._filters[self._tick % len(self._filters)], end)
            self._tick += 1
        news, self._said = self.row is not None and not self._said, self._said or self.row is not None
        return f"The wind is {''.join(self.row.words())}." if news and self.row else ""

    def _table(self, since: float, until: float) -> tuple[Array, Array, Array]:
        """Times (T,), attitudes (T, 3) and velocities (T, 3) between two times, as offline."""
        rows = np.array([one for one in self._attitudes if since <= one[0] < until]).reshape(-1, 4)
        known = np.array([one for one in self._velocities if since - LONGEST_STEP <= one[0]]).reshape(-1, 4)
        after = np.searchsorted(known[:, 0], rows[:, 0])
        rows, after = rows[inside := (after > 0) & (after < len(known))], after[inside]
        rows = rows[known[after, 0] - known[after - 1, 0] <= LONGEST_STEP]
        moved = [np.interp(rows[:, 0], known[:, 0], part) for part in known.T[1:]]
        return rows[:, 0], rows[:, 1:], np.column_stack(moved)

    def _check(self, time: float) -> None:
        """Ends where the vehicle does not fly freely, and begins where it does."""
        stamps, angles, speeds = self._table(time - START, time)
        if len(stamps) < 10 or stamps[-1] - stamps[0] < START / 2:
            return
        try:
            if 0 in np.ptp(np.column_stack([angles[:, 2], speeds[:, :2]]), axis=0):
                raise NotLearnable("Yaw or velocity never changes by a digit: it is not measured.")
            checked(stamps, angles, speeds)
        except NotLearnable as error:
            self.reason, self.row, self._filters = str(error), None, []
            return
        self.reason = ""
        start = motion(stamps, angles, speeds, max(STEP, float(np.median(np.diff(stamps)))))
        if not self._filters and start.known.any():
            self._step, drag = start.step, self.drag or self.set_drag
            places = drawn(drag.mean, drag.covariance, DRAWS)
            places = np.hstack([np.tile(places, (len(SIZES), 1)), np.repeat(SIZES, DRAWS, axis=0)])
            self._filters = [Filter(in_air(places, start), start) for _ in range(round(self._step / ROW))]
            self._tick = ceil(time / ROW)

    def _take(self, run: Filter, end: float) -> None:
        """Goes on by a step of one grid, whose latest ends at ``end``."""
        run.predict()
        stamps, angles, speeds = self._table(end - 2 * self._step, end)
        moved = motion(stamps, angles, speeds, self._step) if len(stamps) > 2 else None
        if moved is not None and moved.known[:1].any():
            run.update(moved.axes[0], moved.velocity[0], moved.force[0], float(moved.doubt[0]))
            run.total *= 1 - self._step / MEMORY
        logs = run.total.reshape(len(SIZES), -1).mean(axis=1) - (((SIZES - GUSTS) / GUSTS_SD) ** 2).sum(axis=1) / 2
        weights = np.repeat(np.exp(logs - logs.max()), DRAWS)
        weights /= weights.sum()
        winds, variances = run.states @ TOTAL.T, np.einsum("ai,gij,aj->ga", TOTAL, run.spreads, TOTAL)
        mean = weights @ winds
        band = quantile() * np.sqrt(weights @ (variances + (winds - mean) ** 2))
        self.row = WindRow(end - self._step, mean, band)
