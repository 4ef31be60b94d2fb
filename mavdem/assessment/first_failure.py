"""What failed first in a flight that was lost, as a fact (a coded finding): one motor, all, thrust, or land detector.

What the commands of the motors show stands in ``failure_by_commands.py``, why all motors were stopped in
``stop_reason.py``. Here the causes are looked for in order, and the first that the log shows is the answer.
"""

from collections.abc import Sequence

import numpy as np

from mavdem.assessment.attitude_losses import LOST_ANGLE
from mavdem.assessment.command_rise import command_rise
from mavdem.assessment.commanded_overturn import commanded_overturn
from mavdem.assessment.failure_by_commands import (
    LossContext,
    failure_by_commands,
    reassigned_outputs,
)
from mavdem.assessment.flights import loss_onset
from mavdem.assessment.lowered_throttle import lowered_throttle
from mavdem.assessment.motor_events import LASTING_SECONDS
from mavdem.assessment.motor_failure import CAUSES_BY_OUTPUT, CAUSES_BY_WEAK_MOTOR
from mavdem.assessment.stop_reason import STOP_REASON_SECONDS, reason_of_stop
from mavdem.dataset.attitude_error import AttitudeError, attitude_error
from mavdem.dataset.flight_states import MANUAL_THROTTLE_MODES, mode_intervals
from mavdem.dataset.grounded import MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import in_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import series_of_boot
from mavdem.facts import Code, Fact
from mavdem.facts.ending import FailedFirst, MotionEvent
from mavdem.ingest.vocabulary import ON_GROUND
from mavdem.witnesses.boot_sensors import BootSensors

CAUSES_OF_ALL_MOTORS = (
    FailedFirst.ALL_OFF_FIRST,
    FailedFirst.FAILSAFE_FIRST,
    FailedFirst.THROTTLE_CLOSED_FIRST,
    FailedFirst.HEIGHT_DIVERGED_FIRST,
    FailedFirst.LANDING_ASSUMED_FIRST,
    FailedFirst.THRUST_SPENT_FIRST,
    FailedFirst.OVERTURN_COMMANDED_FIRST,
    FailedFirst.THROTTLE_LOWERED_FIRST,
)
"""Causes that concern all motors equally, even if the autopilot reports one of them."""

LANDING_PARAMETERS = ("MPC_THR_MIN", "MPC_THR_HOVER", "MOT_SPIN_MIN", "MOT_THST_HOVER")
"""Parameters with levels of thrust, by which PX4 and ArduPilot distinguish a landed vehicle from one that descends.

A vehicle seems to have landed whose thrust is near the minimum, so that this comes first.
"""

HOVER_ESTIMATE_PARAMETER = "MPC_USE_HTE"
"""If it is 1, PX4's land detector takes its estimate of the hover thrust as soon as there is one, and MPC_THR_HOVER
until then (``MulticopterLandDetector.cpp``)."""

DEFAULT_MINIMUM_FRACTION = 0.12 / 0.5
"""Minimum thrust over the thrust in the hover: the defaults of MPC_THR_MIN and MPC_THR_HOVER."""

LEAST_MINIMUM_THRUST = 0.05
"""Smallest value that PX4 allows for MPC_THR_MIN."""

DIVERGENCE_SECONDS = 10.0
"""Seconds after a height estimate diverged within which a loss follows from it: a fall from 100 m takes as long."""


FAILURES_OF_ONE_MOTOR = (*CAUSES_BY_WEAK_MOTOR, *CAUSES_BY_OUTPUT)
"""Failures that name a motor, and so depend on the numbering of the motors."""


def first_failure(
    signals: Signals, events: Sequence[Fact], loss: Fact, collective: float | None
) -> Fact | None:
    """Returns the fact about what failed first before a vehicle was lost; None if the log does not show it.

    If it names a motor, and the numbering of the motors is an assumption, the fact has the figure ``assumed``.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        events: events of the flight, each a fact (a coded finding) with its time.
        loss: the motion event by which the vehicle was lost.
        collective: mean output of all motors in the hover, as a fraction of their range; None if it is not known.
    """
    failure = _failure_before_loss(signals, events, loss, collective)
    if failure is None or failure.code not in FAILURES_OF_ONE_MOTOR or signals.motors is None:
        return failure
    return failure.replace(assumed=True) if signals.motors.geometry.assumed else failure


def _failure_before_loss(
    signals: Signals, events: Sequence[Fact], loss: Fact, collective: float | None
) -> Fact | None:
    """Returns the fact about what failed first, without a mark that the numbering of the motors is assumed.

    The first of these that the log shows is the cause:

    1. A motor was off or stood still when the loss began.
    2. A setpoint turned the vehicle over.
    3. The height estimate diverged.
    4. The commands of the motors, as the loss began, show what failed (:func:`failure_by_commands`).
    5. Before an impact, the throttle was lowered.

    If all motors were switched off, the result says why, such as that the autopilot wrongly assumed a landing.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        events: events of the flight, each a fact (a coded finding) with its time.
        loss: the motion event by which the vehicle was lost.
        collective: mean output of all motors in the hover, as a fraction of their range; None if it is not known.
    """
    boot = loss.figures["boot"]
    onset = loss_onset(loss)
    assert onset is not None
    stopped_motor = _stopped_motor_fact(signals, events, boot, onset)
    if stopped_motor is not None:
        return stopped_motor
    overturn = commanded_overturn(signals, boot, loss.time or onset)
    if overturn is not None:
        return overturn
    error = attitude_error(signals, boot)
    if error is None:
        return None
    divergence = _height_divergence_event(events, boot, onset)
    if divergence is not None:
        return Fact(
            FailedFirst.HEIGHT_DIVERGED_FIRST,
            time=divergence.time,
            cause=divergence,
            later_cause=_throttle_closed_fact(signals, boot, divergence, onset),
        )
    if loss.code is not MotionEvent.HIT:
        loss_context = _context_of_attitude_loss(error, onset)
        return _explained_failure(signals, events, boot, loss_context, collective, onset)
    loss_context = _context_of_impact(events, boot, onset)
    cause = _explained_failure(signals, events, boot, loss_context, collective, onset)
    return lowered_throttle(signals, boot, onset) if cause is None else cause


def _explained_failure(
    signals: Signals,
    events: Sequence[Fact],
    boot: int,
    loss_context: LossContext,
    collective: float | None,
    onset: float,
) -> Fact | None:
    """Returns what the commands of the motors show of a failure as a loss began, with what led to it.

    If the thrust was spent, that is how far the commands had risen before; if all motors were off, why they were.

    Args:
        signals: logged time series of the vehicle, with its motor outputs.
        events: events of the flight, each a fact (a coded finding) with its time.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        loss_context: when something went wrong, and how the vehicle moved then.
        collective: mean output of all motors in the hover, as a fraction of their range; None if it is not known.
        onset: time when the loss began, s since boot.

    Returns:
        The failure as a fact; None if the commands show none.
    """
    cause = failure_by_commands(signals, boot, loss_context)
    if cause is None:
        return None
    if cause.code is FailedFirst.THRUST_SPENT_FIRST:
        rise = command_rise(signals, boot, end_time=cause.start_time)
        return cause if rise is None else cause.replace(**rise._asdict())
    if cause.code is not FailedFirst.ALL_OFF_FIRST:
        return cause
    # An autopilot that wrongly assumes a landing switches all motors off in the air.
    if loss_context.fall_direction is not None and _assumed_landing(signals, boot, onset):
        return _assumed_landing_fact(signals, cause, collective)
    return reason_of_stop(signals, events, boot, cause)


def _stopped_motor_fact(
    signals: Signals, events: Sequence[Fact], boot: int, onset: float
) -> Fact | None:
    """Returns the fact that motors were off, or that one stood still, when a loss began; None if none did.

    Args:
        signals: logged time series of the vehicle, with the parameters that assign outputs to motors.
        events: events of the flight, each a fact (a coded finding) with its time.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        onset: time when the loss began, s since boot.
    """
    motors_off = _events_at(events, MotionEvent.MOTOR_OFF, boot, onset)
    if motors_off:
        names = tuple(event.subject for event in motors_off)
        return Fact(
            FailedFirst.MOTOR_OFF_FIRST,
            time=motors_off[0].time,
            subject=names[0] if len(names) == 1 else "",
            names=names,
            settings=reassigned_outputs(signals, names),
        )
    standing_motor = _standing_motor(events, boot, onset)
    if standing_motor is None:
        return None
    return Fact(
        FailedFirst.MOTOR_STOOD_STILL_FIRST,
        time=standing_motor.time,
        subject=standing_motor.subject,
    )


def _context_of_impact(events: Sequence[Fact], boot: int, impact: float) -> LossContext:
    """Finds when something went wrong before an impact, and which motors were at their limit then.

    The first sign of a failure is a motor at its limit or a fall. Without one, the time begins ``MAX_SETPOINT_DELAY``
    before the impact.

    Args:
        events: events of the flight, each a fact (a coded finding) with its time.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        impact: time of the impact or, if the attitude was lost just before, of that, s since boot.

    Returns:
        The interval from the first sign of a failure to the impact, s since boot, and the names of those motors.
    """
    latest_start = impact - MAX_SETPOINT_DELAY
    # The controller drives motors to their limits in the impact itself, so that only earlier limits are signs.
    motors_at_limit: list[Fact] = []
    for event in _events_at(events, MotionEvent.MOTOR_AT_ITS_STOP, boot, impact):
        if event.start_time < latest_start:
            motors_at_limit.append(event)
    # Falls are found in averages, so that they begin up to a second late, and may end up to a second before the impact.
    falls = _events_at(events, MotionEvent.FELL, boot, latest_start, 2 * MAX_SETPOINT_DELAY)
    start = latest_start
    for event in [*motors_at_limit, *falls]:
        # An event without a time does not move the start.
        start = min(start, event.time or start)
    names_at_limit = [event.subject for event in motors_at_limit]
    return LossContext((start, impact), names_at_limit=names_at_limit)


def _context_of_attitude_loss(error: AttitudeError, onset: float) -> LossContext:
    """Finds the time from the onset of a loss of attitude until the error exceeded ``LOST_ANGLE``.

    In this time the commands of the motors show what failed: later the vehicle tumbles.

    Args:
        error: error of the attitude in the boot.
        onset: time when the loss began, s since boot.

    Returns:
        The interval, s since boot, and the side to which the vehicle fell: the direction of the error at its end.
    """
    is_lost = (error.time >= onset) & (error.magnitude > LOST_ANGLE)
    first_lost_sample = np.argmax(is_lost)
    loss_time = float(error.time[first_lost_sample])
    fall_direction = complex(error.lean[first_lost_sample])
    return LossContext((onset, loss_time), fall_direction=fall_direction)


def _standing_motor(events: Sequence[Fact], boot: int, onset: float) -> Fact | None:
    """Returns the first motor that stood still when a loss began, if a second sensor confirms it.

    The speed controllers may report the standstill up to ``MAX_SETPOINT_DELAY`` later. An event that no second sensor
    confirms is not bad, and is skipped.

    Args:
        events: events of the flight, each a fact (a coded finding) with its time.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        onset: time when the loss began, s since boot.

    Returns:
        The event of the motor; None if none stood still.
    """
    for event in _events_at(events, MotionEvent.MOTOR_STOOD_STILL, boot, onset, MAX_SETPOINT_DELAY):
        if event.is_bad:
            return event
    return None


def _throttle_closed_fact(
    signals: Signals, boot: int, divergence: Fact, onset: float
) -> Fact | None:
    """Returns the fact that the pilot closed the throttle between a diverged height and the loss.

    The flight mode must be one in which the stick sets the thrust: only then does a closed throttle let the vehicle
    fall.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        divergence: event that the height estimate diverged before.
        onset: time when the loss began, s since boot.

    Returns:
        The fact; None if the log does not show it.
    """
    start = max(divergence.latest_time, onset - STOP_REASON_SECONDS)
    throttle_fact = BootSensors(signals, boot).throttle_closed_fact((start, onset))
    manual = mode_intervals(signals, boot, MANUAL_THROTTLE_MODES)
    if throttle_fact is None or not in_intervals(throttle_fact.start_time, manual):
        return None
    return Fact(FailedFirst.THROTTLE_CLOSED_FIRST, time=throttle_fact.time)


def _height_divergence_event(events: Sequence[Fact], boot: int, onset: float) -> Fact | None:
    """Returns the last event, shortly before a loss, that the height estimate diverged.

    A vehicle that follows a false height may fall up to ``DIVERGENCE_SECONDS`` after the estimate is right again.

    Args:
        events: events of the flight, each a fact (a coded finding) with its time.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        onset: time when the loss began, s since boot.

    Returns:
        The event; None if the estimate did not diverge then.
    """
    last_divergence = None
    for event in events:
        is_divergence = event.code is MotionEvent.HEIGHT_DIVERGED and event.is_bad
        if not is_divergence or event.figures.get("boot") != boot:
            continue
        if event.start_time <= onset <= event.latest_time + DIVERGENCE_SECONDS:
            last_divergence = event
    return last_divergence


def _events_at(
    events: Sequence[Fact], code: Code, boot: int, time: float, delay: float = LASTING_SECONDS
) -> list[Fact]:
    """Selects the events of one code that last at a given time.

    Args:
        events: events of the log, each a fact (a coded finding) with its time.
        code: code of the events to return.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        time: time on the boot clock, s.
        delay: events that begin up to this much later, s, are selected too. The default is the time for which most
            states must last to be an event.

    Returns:
        These events, in the order of ``events``.
    """
    selected_events = []
    for event in events:
        if event.code is not code or event.figures["boot"] != boot:
            continue
        has_begun = event.start_time <= time + delay
        has_ended = event.latest_time < time
        if has_begun and not has_ended:
            selected_events.append(event)
    return selected_events


def _assumed_landing(signals: Signals, boot: int, onset: float) -> bool:
    """Returns whether the autopilot reported a landed vehicle within ``MAX_SETPOINT_DELAY`` before ``onset``, s."""
    landed_state = series_of_boot(signals.landed_state, boot)
    if landed_state is None:
        return False
    is_recent = in_intervals(landed_state.time, [(onset - MAX_SETPOINT_DELAY, onset)])
    return bool((landed_state.values[is_recent] == ON_GROUND).any())


def _assumed_landing_fact(signals: Signals, cause: Fact, collective: float | None) -> Fact:
    """Returns the fact that the autopilot switched all motors off in the air because it took the vehicle for landed.

    The autopilot compares the thrust with some parameters to detect a landing. The fact has their values and the thrust
    in the hover as figures, and as ``least_collective`` a lowest thrust that would suit the vehicle.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        cause: the fact that all motors were off, with its time.
        collective: mean output of all motors in the hover, as a fraction of their range; None if it is not known. It
            equals the thrust that the parameters mean only if PX4's THR_MDL_FAC is 0, since that makes the relation
            between the two nonlinear. Otherwise the fact states neither of the two thrusts.
    """
    parameters = signals.telemetry.parameters
    settings = [(name, parameters[name]) for name in LANDING_PARAMETERS if name in parameters]
    hover_thrust = None if parameters.get("THR_MDL_FAC") else collective
    minimum_thrust = None
    if hover_thrust is not None:
        minimum_thrust = max(LEAST_MINIMUM_THRUST, DEFAULT_MINIMUM_FRACTION * hover_thrust)
    return Fact(
        FailedFirst.LANDING_ASSUMED_FIRST,
        time=cause.time,
        settings=settings,
        collective=hover_thrust,
        least_collective=minimum_thrust,
        is_estimated=parameters.get(HOVER_ESTIMATE_PARAMETER) == 1,
    )
