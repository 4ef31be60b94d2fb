"""The wind in metres a second in a recorded flight: which messages say it, and which parts of it count."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.confidence import Interval
from mavdem.dataset import intervals, phases
from mavdem.dataset.attitude import Attitude, attitude_from_messages
from mavdem.dataset.axes import AXES
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.signals import CLIMB_RATE_FIELDS, Signals
from mavdem.dataset.time_series import TimeSeries, clean_series, float_column, recorded_series
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.online import DragSource
from mavdem.facts.wind import NoWind
from mavdem.files import AnyPath
from mavdem.ingest import read_log
from mavdem.ingest.telemetry import Telemetry, interpolated
from mavdem.ingest.vocabulary import mavlink_constant
from mavdem.wind_velocity.airflow import Drag
from mavdem.wind_velocity.drag import LONGEST_SECONDS
from mavdem.wind_velocity.estimation import WindVelocity, estimate_wind

VELOCITY_MESSAGES = {
    name: -factor for name, (field, factor) in CLIMB_RATE_FIELDS.items() if field == "vz"
}
"""Messages with the velocity over ground, the preferred first, and the factor that makes it m/s."""
ESTIMATOR_FLAG_MESSAGES = ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS")
VELOCITY_VALID_FLAG = mavlink_constant("ESTIMATOR_VELOCITY_HORIZ")
STANDSTILL_ASSUMED = mavlink_constant("ESTIMATOR_CONST_POS_MODE")
"""Messages with the estimator's flags: it knows the horizontal velocity; it assumes to stand still."""
VELOCITY_JUMP = (1.0, 15.0)
YAW_JUMP = (0.35, 6.0)
"""m/s, rad, and m/s², rad/s: a change beyond both is a reset. Before one of the yaw, in flight, it was not known."""
# m beyond what the velocity covers, of a reset
POSITION_JUMP = 1.0
# m above the lowest height, without motors; s between velocities, and around a reset that are left out
LOWEST_FLIGHT = 1.5
MAX_VELOCITY_GAP = 1.5
STUCK_LEAN = np.radians(25.0)
STUCK_METRES = 0.1
STUCK_SECONDS = 5.0
"""So far a free vehicle leans against a storm or to move off; simulated in steady wind, where position is held best, it
stays within 0.1 m of where it was a second ago for 1.3 s at most. One that is caught or holds on to something stays."""


class WindEvidence(NamedTuple):
    """What a log shows of the wind in m/s."""

    estimate: WindVelocity | None
    """The wind estimated from attitude and velocity; ``None`` where it cannot be."""

    autopilot_estimate: TimeSeries | None
    """The autopilot's own estimate, north and east in m/s; ``None`` where it was not logged."""

    obstacle: Fact | None
    """Why there is no estimate; ``None`` where there is one."""


def wind(path: AnyPath, vehicle: str | None = None, drag: Drag | None = None) -> WindVelocity:
    """Returns the wind of a log's longest flight, from attitude and velocity over ground at 1 Hz and faster.

    Args:
        path: a log that ``mavdem.ingest.read_log`` reads.
        vehicle: "system" or "system:component", where the log holds several.
        drag: of the vehicle; the autopilot's own coefficients, where somebody set them, unless given.

    Raises:
        Unreadable: the log cannot be read.
        NotLearnable: it holds no vehicle, no velocity, no yaw or no flight, or no free one.
    """
    log = read_log(path)
    flown = choose_vehicle(log.vehicles, vehicle)
    return wind_of_signals(Signals(flown), drag)


def wind_of_signals(signals: Signals, drag: Drag | None = None) -> WindVelocity:
    """Returns the wind of a vehicle's ``signals``, as :func:`wind` does, with the ``drag`` of before."""
    telemetry = signals.telemetry
    # As it was sent: between two angles a reset of the yaw is no jump.
    angles = [
        angle for axis in AXES if (angle := attitude_from_messages(telemetry, axis)) is not None
    ]
    moving = _moving(telemetry)
    if len(angles) < len(AXES) or moving is None:
        missing = AXES[len(angles) :]
        raise NotLearnable(
            NoWind.NO_VELOCITY,
            missing=missing,
            name=telemetry.name_in_source("LOCAL_POSITION_NED"),
            recorder=telemetry.translated_from,
        )
    boots = np.unique(moving.boot).tolist()
    flown = [(_flown(signals, angles, moving, boot), boot) for boot in boots]
    nothing = (np.zeros((0, 8)), 0)
    best, best_boot = max(flown, key=lambda pair: len(pair[0]), default=nothing)
    if len(best) < 10:
        raise NotLearnable(NoWind.NO_FLIGHT_WITH_VELOCITY)
    stuck = _longest_stuck(signals.position, best_boot, best)
    if stuck >= STUCK_SECONDS:
        raise NotLearnable(NoWind.STUCK, duration=stuck, lean=STUCK_LEAN)
    if np.ptp(best[:, 0]) > LONGEST_SECONDS:
        raise NotLearnable(NoWind.CLOCK_JUMPS)
    still = np.ptp(best[:, 3:6], axis=0)[:2]
    if 0 in still:
        raise NotLearnable(NoWind.NOT_MEASURED, name="velocity" if still[0] else "yaw")
    if drag is None:
        drag = Drag.of_parameters(telemetry.autopilot, telemetry.parameters)
    estimate = estimate_wind(best[:, 0], best[:, 1:4], best[:, 4:7], drag, best[:, 7])
    return replace(estimate, boot=best_boot)


def _moving(telemetry: Telemetry) -> TimeSeries | None:
    """(N, 4) velocity over ground, north, east and down, m/s, and height, m; perhaps (N, 6), north and east, m."""
    for name, factor in VELOCITY_MESSAGES.items():
        columns = telemetry.messages.get(name, {})
        if len(columns.get("vx", ())) > 1:
            above = (
                -float_column(columns, "z")
                if factor == 1
                else float_column(columns, "relative_alt") / 1000
            )
            table = [factor * float_column(columns, field) for field in ("vx", "vy", "vz")]
            table.append(np.nan_to_num(above))
            table += [float_column(columns, axis) for axis in "xy" if axis in columns]
            valid = np.asarray(columns["valid"], np.bool_) if "valid" in columns else None
            return clean_series(columns, np.column_stack(table), valid)
    return None


def _flown(signals: Signals, angles: Sequence[Attitude], moving: TimeSeries, boot: int) -> Array:
    """(N, 8) time, attitude, velocity and height of flight in a boot, where the estimator knows them."""
    rows = moving.boot == boot
    time = moving.time[rows]
    moved = moving.values[rows].T
    own = [angle.boot == boot for angle in angles]
    at = angles[-1].time[own[-1]]
    if len(time) < 2 or not all(map(np.any, own)):
        return np.zeros((0, 8))
    turned = [
        np.interp(at, angle.time[here], angle.angle[here])
        for angle, here in zip(angles, own, strict=True)
    ]
    flights = _flights(signals, boot, time, moved[3])
    kept = intervals.in_intervals(at, flights)
    kept &= (at >= time[0]) & (at <= time[-1])
    following = np.searchsorted(time, at)
    after = np.clip(following, 1, len(time) - 1)
    steps = time[after] - time[after - 1]
    kept &= steps <= MAX_VELOCITY_GAP
    by_axis = [_jumps(time, speed, VELOCITY_JUMP) for speed in moved[:2]]
    jumps = np.any(by_axis, axis=0)
    for position, speed in zip(moved[4:], moved, strict=False):
        way = np.diff(position)
        jumps |= is_reset(way, speed[:-1], speed[1:], np.diff(time))
    doubted = [(t - MAX_VELOCITY_GAP, t + MAX_VELOCITY_GAP) for t in time[1:][jumps]]
    kept &= ~intervals.in_intervals(at, doubted)
    turns = _jumps(at, turned[2], YAW_JUMP, 2 * np.pi)
    # after flight it is a fall or a spin
    turns &= at[1:] < np.max(flights, initial=0)
    last_reset = np.max(at[1:][turns], initial=-np.inf)
    kept &= at > last_reset + MAX_VELOCITY_GAP
    for name in ESTIMATOR_FLAG_MESSAGES:
        flags = recorded_series(signals.telemetry, name, "flags")
        if flags is not None and np.any(here := flags.boot == boot):
            bits = flags.values[here].astype(np.int64)
            valid = horizontal_velocity_valid(bits)
            unknown = np.interp(at, flags.time[here], ~valid)
            kept &= unknown == 0
    moving_then = interpolated(at, time, moved[:4].T)
    return np.column_stack([at, *turned, moving_then])[kept]


def horizontal_velocity_valid(flags: Any) -> Any:
    """Returns where an estimator's ``flags`` say that it knows the velocity, and assumes no standstill."""
    return flags & (VELOCITY_VALID_FLAG | STANDSTILL_ASSUMED) == VELOCITY_VALID_FLAG


def _longest_stuck(position: TimeSeries | None, boot: int, flown: Array) -> float:
    """For how long, s, the vehicle leant by ``STUCK_LEAN`` or more of ``flown`` (N, 8) and stayed where it was."""
    if position is None or not np.any(here := position.boot == boot):
        return 0.0
    time, roll, pitch = flown[:, :3].T
    positions = [
        np.interp([time - 1.0, time], position.time[here], axis) for axis in position.values[here].T
    ]
    way = np.diff(positions, axis=1)[:, 0]
    moved = np.linalg.norm(way, axis=0)
    lean = np.arccos(np.cos(roll) * np.cos(pitch))
    stuck = (lean >= STUCK_LEAN) & (moved < STUCK_METRES)
    return intervals.longest_true_duration(time, stuck)


def wind_evidence(signals: Signals) -> WindEvidence:
    """Returns what a vehicle's ``signals`` say of the wind."""
    try:
        return WindEvidence(wind_of_signals(signals), signals.autopilot_wind, None)
    except NotLearnable as error:
        return WindEvidence(None, None, error.fact)


def drag_settings(drag: Drag, telemetry: Telemetry) -> dict[str, tuple[float, float, float]]:
    """Returns the autopilot's parameters to set for a ``drag``, with both ends of 90 % intervals, which it has.

    None for a typical drag: nobody knows it of this vehicle.
    """
    if drag.source is DragSource.POPULATION:
        return {}
    settings = drag.parameters(telemetry.autopilot)
    if telemetry.translated_from != "DataFlash":  # which has all that the firmware has
        return settings
    return {name: ends for name, ends in settings.items() if name in telemetry.parameters}


def _flights(signals: Signals, boot: int, time: Array, height: Array) -> intervals.Intervals:
    """Settled flight; where neither motors nor landed state were recorded, armed flight above the ground."""
    if signals.collective is not None or signals.landed_state is not None:
        return phases.settled_intervals(signals, boot)
    lowest = np.nanmin(height) + LOWEST_FLIGHT
    armed = phases.armed_intervals(signals, boot)
    above = intervals.true_intervals(time, height > lowest)
    up = intervals.intersection(armed, above)
    return [flight for span in up if (flight := phases.without_transients(span, None)) is not None]


def is_reset(moved: Any, before: Any, after: Any, dt: Any) -> Any:
    """Returns whether a change of position, m, in ``dt``, s, is more than speeds ``before`` and ``after`` it cover."""
    covered = (before + after) * dt / 2
    return abs(moved - covered) > POSITION_JUMP + 2 * dt


def _jumps(time: Array, values: Array, limits: Interval, turn: float = np.inf) -> Flags:
    """(N - 1,) where ``values`` change by more than the first of ``limits`` and the second a second."""
    steps = abs(np.diff(values)) % turn
    shorter = np.minimum(steps, turn - steps)
    allowed = limits[0] + limits[1] * np.diff(time)
    return shorter > allowed
