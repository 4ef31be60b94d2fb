"""Alarms of motors that weaken in a live flight: the balance of all motors is tested with each sample."""

from collections import deque
from math import isfinite, nan
from statistics import fmean

from mavdem.containers import Numbers
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.facts import Fact, Facts
from mavdem.facts.watch import WatchFact
from mavdem.live.carried_weight import CarriedWeight
from mavdem.live.gradual_watch import GradualLossWatch
from mavdem.live.lean_watch import LeanWatch
from mavdem.live.recent_messages import MAX_EVENTS
from mavdem.motors.balance import MAX_GAP
from mavdem.motors.balance_blocks import UNKNOWN_LEAN
from mavdem.motors.loss_detection import REFERENCE_SECONDS, MotorLossDetector
from mavdem.motors.motor_changes import (
    MIN_REPORTED_GROWTH,
    MotorChange,
    is_much_larger,
    thrust_losses,
)


class MotorAlarms:
    """Finds lasting changes of the motors' balance sample by sample, and keeps the alarms on weak motors.

    A sequential test finds sudden changes. Flight in which it names no motor is also searched for one that loses thrust
    slowly; that loss is updated as it grows. Shifts of the trims that the lean against the wind may explain are left
    out, as in a log. Motors that do not carry the vehicle's weight, as after a touch-down, are not tested.

    Attributes:
        latest: the latest changes, also those that are no alarms.
        active: the alarms on motors that are weak now; they stay after the landing, until the next flight.
        change_time: time of the latest change of a motor, s of the boot clock; NaN before any.
    """

    def __init__(self) -> None:
        """Begins without a sample of the motor outputs, and so without alarms."""
        self.latest: deque[MotorChange] = deque(maxlen=MAX_EVENTS)
        self.active: Facts = ()
        self.change_time = nan
        # The sequential test for a lasting change, which goes on with each sample; None before any of settled flight.
        self._detector: MotorLossDetector | None = None
        # Whether the motors carry the vehicle's weight: those that run down on the ground are not tested.
        self._carried_weight = CarriedWeight()
        # Boot, mixer geometry and range of the outputs that it tests.
        self._tested_motors: object = None
        # The search for a slow loss in the same samples, and the loss that it has found, as it was reported.
        self._gradual_watch: GradualLossWatch | None = None
        self._reported_loss: MotorChange | None = None
        # Judges which shifts of the trims are beyond what the lean explains, and the shifts that were reported.
        self._lean_watch: LeanWatch | None = None
        self._reported_shifts: list[MotorChange] = []
        # Whether a motor is weak by a sudden loss, and no slow one was reported.
        self._is_suddenly_weak = False
        # Why the test cannot find anything, as of the latest sample.
        self._undetectable_reason: Fact | None = None
        # Boot and time, s of its clock, at which the latest flight began; None before it.
        self._flight_boot: int | None = None
        self._flight_start = nan

    def restart(self) -> None:
        """Resets the test, its reference and the active alarms after a reboot, since their times are of another clock.

        The latest changes of the motors' balance, which the report of the session needs, are kept.
        """
        self._detector = None
        self._gradual_watch = None
        self._lean_watch = None
        self._reported_loss = None
        self._reported_shifts = []
        self._is_suddenly_weak = False
        self._undetectable_reason = None
        self.active = ()
        self.change_time = nan

    def begin_flight(self, time: float, boot: int) -> None:
        """Begins a flight: ends all alarms, and forgets the earlier balance of the motors.

        The reference that the motors are compared with is taken from this flight alone: between two flights, propellers
        may be changed and the load may be shifted.

        Args:
            time: time of the take-off, or when the vehicle was found in the air, s of the boot clock.
            boot: number of the boot.
        """
        self.restart()
        self._flight_boot = boot
        self._flight_start = time

    def reason_not_watched(self, now: float, *, is_flying: bool) -> Fact | None:
        """Returns the reason why a motor that loses thrust would not be detected now.

        The test needs settled flight without a long gap, motor outputs that are fast enough, and a reference of
        ``REFERENCE_SECONDS`` to compare with.

        Args:
            now: present time on the boot clock, s.
            is_flying: whether the vehicle is airborne.

        Returns:
            The reason, as a fact (a coded finding); None if a loss of thrust would be detected.
        """
        if not is_flying:
            return Fact(WatchFact.ON_GROUND_NOW)
        if self._undetectable_reason is not None:
            return self._undetectable_reason
        if self._detector is None:
            return Fact(
                WatchFact.REFERENCE_SHORT, duration=REFERENCE_SECONDS, remaining_duration=None
            )
        if self._detector.reference_time is None:
            return Fact(
                WatchFact.REFERENCE_SHORT,
                duration=REFERENCE_SECONDS,
                remaining_duration=self._detector.seconds_to_reference,
            )
        if now - self._detector.latest_time > MAX_GAP:
            return Fact(WatchFact.SETTLED_FLIGHT_AWAITED)
        return None

    @property
    def changes_in_latest_flight(self) -> tuple[MotorChange, ...]:
        """The changes of the motors' balance that were found in the latest flight.

        A flight goes on if the autopilot restarts in the air (a new boot). Its clock then begins again, so that any
        time in a later boot than that of the take-off is after the take-off.
        """
        takeoff_boot = self._flight_boot
        if takeoff_boot is None:
            return ()
        changes_of_flight = []
        for change in self.latest:
            if change.boot == takeoff_boot:
                is_in_flight = change.time >= self._flight_start
            else:
                is_in_flight = change.boot > takeoff_boot
            if is_in_flight:
                changes_of_flight.append(change)
        return tuple(changes_of_flight)

    @property
    def lasting_thrust_loss(self) -> Fact | None:
        """The worst loss of thrust in the latest flight if a motor has not recovered from one; None otherwise."""
        for loss in thrust_losses(self.changes_in_latest_flight):
            if loss.is_bad:
                return loss
        return None

    @property
    def weak_since(self) -> float | None:
        """Time of the latest change of a motor, s of the boot clock, while one is weak; None while all are sound."""
        has_gradual_loss = self._gradual_watch is not None and self._gradual_watch.loss is not None
        has_sudden_loss = self._detector is not None and bool(self._detector.weak_motors)
        if has_sudden_loss or has_gradual_loss:
            return self.change_time
        return None

    def add_sample(
        self,
        time: float,
        boot: int,
        motors: MotorOutputs,
        commands: list[float],
        heading: float,
        lean: Numbers = UNKNOWN_LEAN,
    ) -> Facts:
        """Takes the motor outputs at one time of settled flight, and tests whether a motor has lost or regained thrust.

        The test (``MotorLossDetector``) looks for a lasting change of the balance, the torque about each axis that the
        commands of the motors make. If one motor explains the change, the alarms on all motors that are weak then
        become the active ones. A sample in which the motors do not carry the vehicle's weight is left out.

        Args:
            time: time of the sample, s of the boot clock.
            boot: number of the boot; a boot lasts from one start of the autopilot to the next.
            motors: the latest motor outputs, of which mixer geometry and range are used.
            commands: (k,) outputs of the k motors, as fractions of the range.
            heading: yaw, rad; NaN where the attitude does not follow its setpoint.
            lean: roll and pitch, rad; NaN where they are not known.

        Returns:
            A fact (coded finding) for each change that this sample completes; most samples complete none. A shift of
            the trims is one of them only once it is beyond the lean.
        """
        self._begin_test_of_other_motors(boot, motors)
        if not self._carried_weight.is_carried(time, fmean(commands)):
            return ()
        assert self._detector is not None
        assert self._lean_watch is not None
        facts = []
        for change in self._detector.update(time, commands, heading, lean):
            if self._is_part_of_gradual_loss(change):
                # The user knows it already.
                continue
            if change.motor is None:
                # A shift of the trims is reported below, once it is known to be beyond the lean.
                continue
            self.latest.append(change)
            self._update_active_alarms(change)
            facts.append(change.event)
        self._lean_watch.add_sample(time, commands, lean)
        facts += self._update_shifts()
        self._undetectable_reason = self._detector.undetectable_reason
        follows_setpoint = isfinite(heading)
        if follows_setpoint:
            facts += self._search_gradual_loss(time, commands, lean)
        return tuple(facts)

    def _begin_test_of_other_motors(self, boot: int, motors: MotorOutputs) -> None:
        """Begins the test anew if it has not tested these motors so far; otherwise it does nothing.

        The balance of other motors, or that on another range of the outputs, cannot be compared with the former one.

        Args:
            boot: number of the boot.
            motors: the latest motor outputs, of which mixer geometry and range are used.
        """
        tested_motors = (boot, motors.geometry, motors.scale.low, motors.scale.high)
        if self._detector is not None and tested_motors == self._tested_motors:
            return
        self._detector = MotorLossDetector(motors.geometry, boot)
        self._gradual_watch = GradualLossWatch(motors.geometry, boot)
        self._lean_watch = LeanWatch(motors.geometry)
        self._carried_weight = CarriedWeight()
        self._tested_motors = tested_motors

    def withdraw_since(self, time: float) -> Facts:
        """Judges the shifts of the motors' trims again, without the flight since a given time.

        It is called when a landing or a loss of control is recognised, which began at that time. What the motors did
        since then says nothing about their trims.

        Args:
            time: beginning of the landing or of the loss of control, s of the boot clock.

        Returns:
            A fact (coded finding) for each shift that only now is beyond what the lean explains; mostly none.
        """
        if self._lean_watch is None:
            return ()
        self._lean_watch.withdraw_since(time)
        return self._update_shifts()

    def _update_shifts(self) -> Facts:
        """Updates which shifts of the trims are among the latest changes, and returns those to report.

        A shift is among them while it is beyond what the lean against the wind explains. The flight that follows may
        show that the lean explains it: then it is removed, and if it comes back later it is not reported twice.

        Returns:
            A fact (coded finding) for each shift that was not reported before.
        """
        assert self._detector is not None
        assert self._lean_watch is not None
        shifts = self._lean_watch.unexplained_shifts(self._detector.alarms)
        for change in self._reported_shifts:
            is_explained_now = change in self.latest and change not in shifts
            if is_explained_now:
                self.latest.remove(change)
        new_shifts = [change for change in shifts if change not in self.latest]
        self.latest.extend(new_shifts)
        unreported_shifts = [change for change in new_shifts if change not in self._reported_shifts]
        self._reported_shifts += unreported_shifts
        return tuple(change.event for change in unreported_shifts)

    def _update_active_alarms(self, change: MotorChange) -> None:
        """Replaces the active alarms after a change of one motor: one alarm for each motor that is weak now.

        Sudden and slow losses of thrust are found by different tests. Of a motor with both, the alarm states the slow
        loss, which includes the sudden one. If no motor is weak any more, the event of the recovery replaces the
        alarms.

        Args:
            change: the change of one motor.
        """
        assert self._detector is not None
        self.change_time = change.onset_time
        losses_by_motor = {loss.name: loss for loss in self._detector.weak_motors.values()}
        if self._reported_loss is not None and self._gradual_watch is not None:
            # The loss as it is now, or as it was reported if the test does not find it any more.
            gradual_loss = self._gradual_watch.loss or self._reported_loss
            losses_by_motor[gradual_loss.name] = gradual_loss
        if losses_by_motor:
            self.active = tuple(loss.event for loss in losses_by_motor.values())
        else:
            self.active = (change.event,)

    def _is_part_of_gradual_loss(self, change: MotorChange) -> bool:
        """Returns whether a change that the sequential test has found is the latest part of a known slow loss."""
        loss = self._reported_loss
        return loss is not None and change.is_weak and change.name == loss.name

    def _search_gradual_loss(self, time: float, commands: list[float], lean: Numbers) -> Facts:
        """Searches the flight for a motor that loses thrust slowly, and reports the result.

        The search (:class:`GradualLossWatch`) gets each sample and runs once a second. A motor that has suddenly lost
        thrust looks to this search like one that loses it slowly. So, while a sudden loss lasts, which was reported, a
        slow one is reported only if it is much larger: then the sudden one was a part of it. When the sudden loss is
        over, the search begins anew.

        Args:
            time: time of the sample, s of the boot clock.
            commands: (k,) outputs of the k motors, as fractions of the range.
            lean: roll and pitch, rad; NaN where they are not known.

        Returns:
            The report of a slow loss or of its end; most samples have none.
        """
        assert self._detector is not None
        assert self._gradual_watch is not None
        watch = self._gradual_watch
        if not watch.is_continued(time):
            # After a landing or a long gap, commands of sound flight to compare with are missing. So nothing shows
            # whether the reported loss is over, and its end is not reported.
            self._reported_loss = None
        # The sudden losses that last. Once a slow loss is reported, they are parts of it, and do not count any more.
        sudden_losses = []
        if self._reported_loss is None:
            sudden_losses = list(self._detector.weak_motors.values())
        has_sudden_loss_ended = self._is_suddenly_weak and not sudden_losses
        if has_sudden_loss_ended:
            # The commands until now, which contain this loss, are no reference for a slow one.
            watch.restart()
        self._is_suddenly_weak = bool(sudden_losses)
        watch.add_sample(time, commands, lean)
        gradual_loss = watch.loss
        if gradual_loss is None:
            return self._report_end_of_gradual_loss(time)
        if sudden_losses and not is_much_larger(gradual_loss, sudden_losses):
            # It is only the sudden loss, which this search has found too.
            return ()
        return self._report_gradual_loss(gradual_loss)

    def _report_gradual_loss(self, loss: MotorChange) -> Facts:
        """Stores the newest figures of a slow loss, and reports it when it is new or has grown.

        Args:
            loss: the loss as of the latest search.

        Returns:
            The event of the loss, if another motor lost thrust than in the latest report, or if the loss is
            ``MIN_REPORTED_GROWTH`` times as large as in that report; otherwise nothing.
        """
        former_report = self._reported_loss
        if former_report is None or former_report.name != loss.name:
            # No loss of this motor is reported now.
            is_report_due = True
            self.latest.append(loss)
            # A sudden loss was a part of this one, and is not followed any more. So its end must not begin the search
            # for slow losses anew.
            self._is_suddenly_weak = False
        else:
            is_report_due = loss.size >= MIN_REPORTED_GROWTH * former_report.size
            self._update_latest_loss(loss)
        if is_report_due:
            self._reported_loss = loss
        # The alarm shows the newest figures, whether they are reported or not.
        self._update_active_alarms(loss)
        return (loss.event,) if is_report_due else ()

    def _report_end_of_gradual_loss(self, time: float) -> Facts:
        """Reports that a motor has recovered from the slow loss that was reported; nothing if none was.

        Args:
            time: time of the recovery, s of the boot clock.

        Returns:
            The event of the recovery, if there is one.
        """
        if self._reported_loss is None:
            return ()
        # A change of size 0 is a recovery.
        recovery = self._reported_loss._replace(time=time, onset_time=time, size=0.0, loss=())
        self._reported_loss = None
        self.latest.append(recovery)
        self._update_active_alarms(recovery)
        return (recovery.event,)

    def _update_latest_loss(self, loss: MotorChange) -> None:
        """Replaces the size of a motor's latest loss of thrust by a newer estimate; its times stay.

        Nothing changes if the latest changes have no loss of this motor since the autopilot was started.

        Args:
            loss: the loss by the latest search, which estimates its size from more samples.
        """
        # A motor may have lost thrust several times, and recovered in between: its last loss is updated.
        for index in reversed(range(len(self.latest))):
            change = self.latest[index]
            is_of_same_motor = change.name == loss.name and change.boot == loss.boot
            is_loss = change.is_weak
            if is_of_same_motor and is_loss:
                self.latest[index] = loss._replace(time=change.time, onset_time=change.onset_time)
                return
