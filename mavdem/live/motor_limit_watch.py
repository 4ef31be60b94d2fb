"""Watch of a live vehicle's motors at the limits of their outputs: an oscillation, sinking, or a motor at its limit."""

from __future__ import annotations

from mavdem.arrays import Flags
from mavdem.assessment.lights.motors import motors_at_limits_in_oscillation
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.parameter_history import ParametersInFlight
from mavdem.dataset.quality import samples_at_limits
from mavdem.facts import Fact
from mavdem.facts.margins import MarginsLight
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.live.active_alarms import ActiveAlarms
from mavdem.live.control_watch import ControlWatch
from mavdem.live.live_signals import FlightMoment, RecentMotion
from mavdem.live.motor_limits import motor_at_upper_limit, sinks_at_limit, with_motors_of_alarm
from mavdem.live.review import Review
from mavdem.live.samples import DECISION_SECONDS
from mavdem.loops.advice import gain_reduction_advice
from mavdem.loops.limit_cycles import (
    Oscillation,
    continued_limit_cycle,
    detect_starting_limit_cycle,
)


class MotorLimitWatch:
    """Watches in one boot whether motors reach the limits of their outputs, which shows three faults.

    1. A limit cycle (oscillation) begins: the motors go from limit to limit.
    2. The vehicle sinks with motors at their upper limit although it should hold its height.
    3. A motor stays at its upper limit. This is less urgent than the second fault, and not looked for beside it.
    """

    def __init__(self, control: ControlWatch, alarms: ActiveAlarms, boot: int) -> None:
        """Begins without an oscillation.

        Args:
            control: has the setpoints and climb rates of the last seconds.
            alarms: the active alarms, of which those on oscillation and motor limits go on while the fault lasts.
            boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        """
        self._control = control
        self._alarms = alarms
        self._boot = boot
        # The limit cycle of the latest alarm, as it is stated; None before any.
        self._limit_cycle: Oscillation | None = None

    def judge(self, review: Review, moment: FlightMoment, motion: RecentMotion) -> None:
        """Looks for the three faults in the last seconds of flight.

        Args:
            review: the review, to whose ``facts`` the faults are added.
            moment: present time.
            motion: attitude and motor outputs of the last seconds.
        """
        motors = motion.motors
        outputs = motors.scale.fraction(motors.outputs)
        # Flags (N, k): N samples of k motors.
        is_at_upper, is_at_lower = samples_at_limits(outputs, motors.scale)
        # Motors that reach their limits bound the amplitude of a limit cycle. Where none does, as in most flights,
        # there is no need to look for one.
        if is_at_upper.any() or is_at_lower.any():
            self._judge_oscillation(review, motion)
        if not is_at_upper.any():
            return
        fault = self._sinking_at_limit(review, moment, motors, is_at_upper)
        if fault is None:
            fault = self._motor_at_limit(review, motors, is_at_upper)
        if fault is not None:
            review.facts[WatchedQuantity.MOTOR_LIMITS] = fault

    def _judge_oscillation(self, review: Review, motion: RecentMotion) -> None:
        """Judges whether a limit cycle, an oscillation from limit to limit, begins in the last seconds.

        Args:
            review: the review, to whose ``facts`` the oscillation is added with the gains that should be lowered.
            motion: attitude and motor outputs of the last seconds.
        """
        limit_cycle = detect_starting_limit_cycle(
            motion.motors,
            motion.tilts,
            self._control.setpoints(review.vehicle),
            self._boot,
            review.phase_start,
            review.now,
        )
        if limit_cycle is None:
            return
        is_alarm_active = WatchedQuantity.OSCILLATION in self._alarms.facts
        if self._limit_cycle is not None and is_alarm_active:
            limit_cycle = continued_limit_cycle(self._limit_cycle, limit_cycle)
        self._limit_cycle = limit_cycle
        # The gains to lower follow by the same rule as in the judgement of the recording after the landing.
        parameters = ParametersInFlight.unchanged(review.vehicle.parameters)
        advice = gain_reduction_advice(limit_cycle, parameters)
        review.facts[WatchedQuantity.OSCILLATION] = Fact(
            MarginsLight.OSCILLATES, reason=advice, **limit_cycle.figures
        )

    @property
    def swinging_motors(self) -> Fact | None:
        """The fact that motors reach their limits in the latest limit cycle of this boot; None if they did not."""
        return motors_at_limits_in_oscillation(self._limit_cycle)

    def _sinking_at_limit(
        self, review: Review, moment: FlightMoment, motors: MotorOutputs, is_at_upper: Flags
    ) -> Fact | None:
        """Returns the fact that the vehicle sinks, although it should hold its height, with motors at their limit.

        Args:
            review: the review, with its time.
            moment: present time, and the motion.
            motors: outputs of the k motors in the last seconds, N samples.
            is_at_upper: (N, k) whether each output is at its motor's upper limit.

        Returns:
            The fact; None if the vehicle does not sink, is not to hold its height, or descends by command.
        """
        climb_rate = self._control.climb_rate_in_height_hold(moment)
        if climb_rate is None:
            return None
        sinking = sinks_at_limit(motors, is_at_upper, climb_rate, review.now)
        if sinking is None:
            return None
        # The fact names the motors at their limit only if other motors have reserve. If none has, not even a commanded
        # descent explains it.
        have_others_reserve = bool(sinking.figures["names"])
        if have_others_reserve and self._control.is_descent_commanded(moment):
            return None
        return sinking

    def _motor_at_limit(
        self, review: Review, motors: MotorOutputs, is_at_upper: Flags
    ) -> Fact | None:
        """Returns the fact that motors stay at their upper limits, joined with the active alarm if there is one.

        Args:
            review: the review, with its time and that of the take-off.
            motors: outputs of the k motors in the last seconds, N samples.
            is_at_upper: (N, k) whether each output is at its motor's upper limit.

        Returns:
            The fact, which names the motors; None if no motor stays there, and just after a take-off.
        """
        has_just_taken_off = review.now - review.phase_start < DECISION_SECONDS
        motors_at_limit = motor_at_upper_limit(motors, is_at_upper, review.now)
        if motors_at_limit is None or has_just_taken_off:
            return None
        active_alarm = self._alarms.facts.get(WatchedQuantity.MOTOR_LIMITS)
        if active_alarm is not None and active_alarm.code is WatchFact.SINKS_AT_LIMIT:
            # A vehicle that could not hold its height has not become sound while a motor is at its limit.
            return active_alarm
        return with_motors_of_alarm(motors_at_limit, active_alarm)
