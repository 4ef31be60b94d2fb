"""Sequential detection, in flight, of a motor that loses thrust and lastingly works harder than before.

What is compared with what: docs/motors.md. The hypotheses exclude each other: nothing changed; motor i works harder, by
5 to 80 %, which shows as its signature; a load shifted, which changes the steady torque in roll and pitch, and in yaw
if the vehicle leans; the torque in yaw alone changed; all three did, of any cause; and once motors are weak, one of
them recovers, or all of them do. Each hypothesis has a Bayes factor against "nothing changed", a mixture over the size
of the change. Summed over the times at which the change may have begun, they are a Shiryaev-Roberts statistic. Were the
noise known, the mean time to a false alarm would be at least A steps for a threshold of A (M. Pollak, "Optimal
detection of a change in distribution", Annals of Statistics 1985; with mixtures: J. Shin, A. Ramdas and A. Rinaldo,
"E-detectors", New England Journal of Statistics in Data Science 2024). The variance is estimated here, and the largest
of several is taken, so the threshold is a design value and no bound; ``FALSE_ALARMS`` has what was measured. Which
change it is, is decided by the Bayes factors against each other, as in S. Dayanik, C. Goulding and H. V. Poor,
"Bayesian sequential change diagnosis", Mathematics of Operations Research 2008.

After a change, the balance that it left is the reference, and the noise before it is the prior of the noise after it. A
loss that does not last is withdrawn (``loss_confirmation.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, log
from typing import NamedTuple, Self

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.confidence import STRONG_EVIDENCE_NATS
from mavdem.containers import Numbers
from mavdem.facts import Fact
from mavdem.facts.motors import MotorWatchFact
from mavdem.ingest.motors import MotorGeometry
from mavdem.motors.balance import MAX_GAP, MIN_STEADY_SECONDS
from mavdem.motors.balance_blocks import (
    MIN_SAMPLE_RATE,
    UNKNOWN_LEAN,
    BalanceBlocks,
    BlockAverager,
    CommandBlock,
    SampleRate,
)
from mavdem.motors.balance_model import BalanceModel
from mavdem.motors.change_causes import (
    RISES,
    CauseEvidence,
    can_reach_threshold,
    cause_evidence,
    cause_probabilities,
    hypothetical_rises,
    log_odds_of_motor_cause,
    log_sum,
)
from mavdem.motors.change_statistics import (
    BLOCK_SECONDS,
    PRIOR_FREEDOM,
    WindowChanges,
    Windows,
    changes_with_least_variance,
    log_t_density,
    window_changes,
    window_means,
)
from mavdem.motors.heading_sectors import is_independent_of_heading
from mavdem.motors.health import MIN_NAMED_PROBABILITY
from mavdem.motors.loss_confirmation import LossConfirmation
from mavdem.motors.motor_changes import CauseProbabilities, MotorChange, SuspectedMotor
from mavdem.motors.signatures import motor_signatures

REFERENCE_SECONDS = 8.0
"""Seconds of flight that must precede the first change, and that a change in roll and pitch alone must last.

A gust is over by then.
"""

NEXT_REFERENCE_SECONDS = 2.0
"""Seconds of flight that must precede another change: by then the noise is known."""

KEPT_SECONDS = 150.0
"""Seconds of flight that are remembered; a choice, a few times the memory of the reference."""

SETTLING_BLOCKS = 2
"""Number of blocks after a motor's change in which the vehicle settles, and which are not a reference."""

WINDOW_BLOCKS = (2, 3, 4, 6, 8, 10, 14, 20, 30, 40)
"""Numbers of blocks since the change began, for which it is tested; a choice."""

STALE_SECONDS = 15.0
"""Seconds after which a change of any cause makes what was before no reference."""

HOURS_TO_FALSE_ALARM = 10.0
"""Mean time to a false alarm by design, hours."""

MAX_RECOVERED_FRACTION = 1 / 4
"""Fraction of its former rise below which a motor's remaining rise counts as recovered: the rise may be wrong by it."""

PRIOR_BLOCK_SD = 0.006
"""Standard deviation of a block's balance before the flight has shown its own, relative to the mean command."""

MAX_PRIOR_FREEDOM = 60.0
"""Degrees of freedom, at most, of the noise before a change as a prior of that after it: those of a whole reference."""

OTHERS_PER_LOAD = 0.05
"""Prior odds of a change that is neither a motor's nor in roll and pitch alone, against one in roll and pitch.

A load that shifts in wind changes yaw too.
"""

TOO_SLOW = Fact(MotorWatchFact.MOTOR_OUTPUTS_TOO_SLOW, needed_rate=MIN_SAMPLE_RATE)
"""Why no change can be detected where motor outputs come too slowly."""


class _DatedChange(NamedTuple):
    """A change of the balance, with the time at which it most probably began."""

    changes: WindowChanges
    """Change for each window: for each assumption on when it began."""
    window: int
    """Index of the window that explains the change best."""
    block_count: int
    """Number of blocks since the change began: the length of that window."""

    @classmethod
    def most_likely(cls, changes: WindowChanges, windows: Windows, log_factors: Array) -> Self:
        """Returns the change in the window in which a cause explains it best, which dates its beginning.

        Args:
            changes: Change of the balance for each window.
            windows: (w,) lengths of the windows, in blocks.
            log_factors: (w,) logarithm of the cause's Bayes factor by window.
        """
        window = int(np.argmax(log_factors))
        return cls(changes, window, int(windows[window]))

    @property
    def size(self) -> Array:
        """(a,) change of the balance."""
        return self.changes.change[self.window]

    @property
    def variance(self) -> Array:
        """(a,) its variance."""
        return self.changes.variance[self.window]


def _of_lasting_windows(log_factors: Array, is_lasting: Flags) -> Array:
    """Returns logarithms (w,) of Bayes factors by window, with −∞, that of 0, for windows that are too short.

    Args:
        log_factors: (w,) logarithms of the Bayes factors.
        is_lasting: (w,) whether a window is long enough: then a change in it lasts.
    """
    return np.where(is_lasting, log_factors, -inf)


class MotorLossDetector:
    """Sequential test of whether the balance of a vehicle's motors changed in flight, block by block; for one boot.

    Attributes:
        alarms: Changes that were detected so far.
        weak_motors: Latest alarm on each motor that has not recovered, by its index; empty after a gap of ``MAX_GAP``.
        latest_time: Time of the last sample, s.
        reference_time: Since when there is enough flight to compare with, s; None without.
        undetectable_reason: Why no change can be detected; None if it can. It is known after a few seconds
            of settled flight.
    """

    def __init__(self, geometry: MotorGeometry, boot: int = 0) -> None:
        """Begins the test.

        Args:
            geometry: Positions and spins of the vehicle's k motors.
            boot: Number of the vehicle's boot, from 0.
        """
        self.alarms: list[MotorChange] = []
        self.weak_motors: dict[int, MotorChange] = {}
        self.latest_time = -inf
        self.reference_time: float | None = None
        mixer = motor_signatures(geometry)
        self._is_identifiable = mixer.is_motor_identifiable
        self.undetectable_reason: Fact | None = None
        if not self._is_identifiable:
            self.undetectable_reason = Fact(MotorWatchFact.MOTOR_PLACES_UNKNOWN)
        self._geometry = geometry
        self._boot = boot
        self._threshold = log(HOURS_TO_FALSE_ALARM * 3600 / BLOCK_SECONDS)
        self._model = BalanceModel(mixer)
        self._averager = BlockAverager()
        self._sample_rate = SampleRate()
        self._blocks = BalanceBlocks()
        # The loss of thrust that was detected a moment ago, and is not confirmed yet; None without one.
        self._unconfirmed_loss: LossConfirmation | None = None
        # Prior of the long-run variance (a,) of a block's balance, and its degrees of freedom.
        self._noise_variance = np.full(len(self._model.torque_rows), PRIOR_BLOCK_SD**2)
        self._degrees_of_freedom = PRIOR_FREEDOM

    def update(
        self,
        time: float,
        commands: Sequence[float] | Array,
        heading: float = 0.0,
        lean: Sequence[float] | Array = UNKNOWN_LEAN,
    ) -> list[MotorChange]:
        """Adds a sample of settled flight, and tests for a change whenever a block of samples is complete.

        After a gap of ``MAX_GAP``, or if the clock goes back by as much, the test begins anew.

        Args:
            time: Seconds on the clock of the boot.
            commands: (k,) motor outputs as fractions of the range.
            heading: Heading, rad; NaN where the attitude does not follow its setpoint.
            lean: (2,) roll and pitch, rad; NaN where they are not known.

        Returns:
            The changes that are detected with this sample.
        """
        if not self._is_identifiable:
            return []
        step = time - self.latest_time
        if -MAX_GAP < step <= 0:
            # A repeated message, or one that another has overtaken, is left out.
            return []
        # After a landing, or with another clock, the flight before is not a reference. The first sample restarts, too,
        # since the latest time before it is minus infinity.
        is_continued = 0 < step < MAX_GAP
        if not is_continued:
            self._restart(time, heading)
        self.latest_time = time
        # Whether samples come fast enough is decided once in ``REFERENCE_SECONDS``, and is None in between.
        is_fast_enough = self._sample_rate.add_sample(time, REFERENCE_SECONDS)
        if is_fast_enough is not None:
            self.undetectable_reason = None if is_fast_enough else TOO_SLOW
        alarm_count = len(self.alarms)
        completed_block = self._averager.add(time, commands, heading, lean)
        if completed_block is not None:
            self._add_block(completed_block)
        return self.alarms[alarm_count:]

    def _restart(self, time: float, heading: float) -> None:
        """Discards the flight before a gap, with its reference, its weak motors, and what it showed of the noise.

        Args:
            time: Time of the next sample, s.
            heading: Heading at that sample, rad.
        """
        self._averager.restart(time, heading)
        self._sample_rate.restart(time)
        self._blocks.clear()
        self._unconfirmed_loss = None
        # The long-run variance of a block has its first prior again.
        self._noise_variance = np.full(len(self._model.torque_rows), PRIOR_BLOCK_SD**2)
        self._degrees_of_freedom = PRIOR_FREEDOM
        self.reference_time = None
        self.weak_motors.clear()

    @property
    def seconds_to_reference(self) -> float:
        """Settled flight that is missing until a loss of thrust can be detected for the first time, s; 0 afterwards.

        That takes a reference of ``REFERENCE_SECONDS``, and after it the shortest window that is tested for a change.
        """
        if self.reference_time is not None:
            return 0.0
        needed_seconds = REFERENCE_SECONDS + min(WINDOW_BLOCKS) * BLOCK_SECONDS
        return max(needed_seconds - len(self._blocks) * BLOCK_SECONDS, 0.0)

    def _add_block(self, block: CommandBlock) -> None:
        """Adds a block, ``BLOCK_SECONDS`` of flight, and tests whether the motors' balance changed lately.

        The balance is the torque about each axis that the motors' commands make, relative to their mean. First it is
        tested whether a loss that was detected before persists. Then the test for a change is run with windows of
        several lengths, each an assumption on how many blocks ago the change began. A window is used only if enough
        flight precedes it as a reference. There is no test while too many blocks are missing, since the variances would
        be wrong.

        Args:
            block: Mean commands of the block.
        """
        # The mean command is a measure of the thrust. It is 0 or NaN for motors that stand still or have no command.
        mean_command = block.commands.mean()
        do_motors_run = mean_command > 0
        if not do_motors_run:
            return
        # The balance is relative to the mean command, so that neither battery nor climb changes it.
        balance = self._model.torque_rows @ (block.commands / mean_command)
        self._blocks.add(block.end, balance, block.heading, block.lean)
        self._blocks.keep_last(round(KEPT_SECONDS / BLOCK_SECONDS))
        if self._blocks.has_gaps:
            return
        self._confirm_or_withdraw_loss()
        # After a change of a motor was detected, the noise of the flight before it is the prior, with more degrees of
        # freedom than the initial prior. As the noise is known then, a shorter reference is enough.
        has_changed_before = self._degrees_of_freedom > PRIOR_FREEDOM
        reference_seconds = NEXT_REFERENCE_SECONDS if has_changed_before else REFERENCE_SECONDS
        # Each window needs a reference before it.
        blocks_after_reference = len(self._blocks) - reference_seconds / BLOCK_SECONDS
        windows = [length for length in WINDOW_BLOCKS if length <= blocks_after_reference]
        if windows:
            if self.reference_time is None:
                self.reference_time = block.end
            self._test_for_change(np.array(windows, dtype=int))

    def _confirm_or_withdraw_loss(self) -> None:
        """Withdraws the loss that was detected last if the balance has returned to its value before.

        Then the motor is no longer weak, its recovery is added to the alarms, and only the blocks since the return are
        kept as a reference. A loss that is not withdrawn within its time for confirmation is confirmed, and not tested
        again.
        """
        loss = self._unconfirmed_loss
        time = self._blocks.times[-1]
        if loss is None or not loss.is_decidable(time):
            return
        # Only blocks after the detection show whether the balance returned.
        first_block = int(np.searchsorted(self._blocks.times, loss.detection, side="right"))
        balances = self._blocks.balances[first_block:]
        log_odds = loss.log_odds_of_return(self._blocks.times[first_block:], balances)
        if log_odds >= STRONG_EVIDENCE_NATS:
            self._unconfirmed_loss = None
            self.weak_motors.pop(loss.motor)
            block_count = loss.blocks_since_return(balances)
            self._add_alarm(loss.motor, block_count, log_odds, 0.0)
            # The reference of later flight begins where the balance returned.
            self._blocks.keep_last(block_count)
        elif loss.is_over(time):
            self._unconfirmed_loss = None

    def _test_for_change(self, windows: Windows) -> None:
        """Tests whether the motors' balance changed within the last blocks, and records a change of a motor.

        A Bayes factor says how much better a cause explains the change than "nothing changed" does. The causes are the
        loss or recovery of each motor, a load (a change in roll and pitch alone), and other changes (in yaw alone, or
        in all axes). The steps are:

        1. Stop if the change is too small for any cause.
        2. Take the motor cause with the largest Bayes factor. It must reach the threshold, which keeps false alarms
           rare, and its odds against all other causes together must be strong, so that no sound motor is named.
        3. Record it, unless a turn of the vehicle in wind explains it.
        4. If no motor cause passes step 2, test whether a load or something unknown changed the torque.

        Args:
            windows: (w,) lengths of the windows in blocks: possible numbers of blocks since the change began.
        """
        balances = np.array(self._blocks.balances)
        means = window_means(balances, windows)
        # A change that no cause explains with the least variance is not explained with a larger one, which takes longer
        # to estimate.
        most_certain_changes = changes_with_least_variance(
            means, self._noise_variance, self._degrees_of_freedom
        )
        log_density = log_t_density(most_certain_changes, 0.0)
        if not self._can_reach_threshold(most_certain_changes, log_density):
            return
        changes = window_changes(balances, means, self._noise_variance, self._degrees_of_freedom)
        log_density_without_change = log_t_density(changes, 0.0)
        if not self._can_reach_threshold(changes, log_density_without_change):
            return
        weak_motor_sizes = {motor: alarm.size for motor, alarm in self.weak_motors.items()}
        leans = np.array(self._blocks.leans)
        lean_in_windows = np.array([leans[-length:].mean(axis=0) for length in windows])
        evidence = cause_evidence(
            changes,
            log_density_without_change,
            self._model.signatures,
            lean_in_windows,
            weak_motor_sizes,
        )
        best_cause = int(np.argmax(evidence.motor_log_factors))
        log_odds = log_odds_of_motor_cause(evidence, best_cause)
        reaches_threshold = evidence.motor_log_factors[best_cause] >= self._threshold
        if not reaches_threshold or log_odds < STRONG_EVIDENCE_NATS:
            self._test_for_torque_change(windows, changes, evidence)
            return
        log_factors_of_cause = evidence.motor_log_factors_by_window[best_cause]
        change = _DatedChange.most_likely(changes, windows, log_factors_of_cause)
        if self._is_independent_of_heading(change):
            # (k,) rises of the motors with the largest size. Only the ratios between the motors matter.
            largest_rises = evidence.rises[best_cause, -1]
            self._record_motor_change(largest_rises, change, log_odds)

    def _can_reach_threshold(
        self, changes: WindowChanges, log_density_without_change: Array
    ) -> bool:
        """Returns whether any cause could explain the changes of the balance well enough for an alarm.

        Args:
            changes: Change of the balance for each of w windows.
            log_density_without_change: (w,) log density of the changes if the balance did not change.
        """
        # The loss of each motor, and the recovery of each weak one.
        motor_cause_count = len(self._model.signatures) + len(self.weak_motors)
        return can_reach_threshold(
            changes, log_density_without_change, motor_cause_count, self._threshold
        )

    def _test_for_torque_change(
        self, windows: Windows, changes: WindowChanges, evidence: CauseEvidence
    ) -> None:
        """Tests whether something other than a motor changed the steady torque: first a load, then any cause.

        Args:
            windows: (w,) lengths of the windows, in blocks: the change may have begun so many blocks ago.
            changes: Change of the balance for each window.
            evidence: Logarithms of the Bayes factors of all causes, some of them by window.
        """
        has_load_shifted = self._test_for_shifted_load(windows, changes, evidence)
        if not has_load_shifted:
            self._test_for_stale_reference(windows, changes, evidence)

    def _test_for_shifted_load(
        self, windows: Windows, changes: WindowChanges, evidence: CauseEvidence
    ) -> bool:
        """Tests whether a load has shifted, at least ``REFERENCE_SECONDS`` ago: a gust is shorter.

        The Bayes factor of a load must reach the threshold, and its odds against all other causes must be strong
        evidence.

        Args:
            windows: (w,) lengths of the windows, in blocks.
            changes: Change of the balance for each window.
            evidence: Logarithms of the Bayes factors of all causes.

        Returns:
            Whether the evidence is strong enough.
        """
        is_lasting = windows * BLOCK_SECONDS >= REFERENCE_SECONDS
        load_log_factors = _of_lasting_windows(evidence.load_log_factors, is_lasting)
        load_log_factor = log_sum(load_log_factors)
        # The last rival is that nothing changed, with a Bayes factor of 1.
        rivals = [
            *evidence.motor_log_factors,
            evidence.other_log_factor + log(OTHERS_PER_LOAD),
            0.0,
        ]
        log_odds = load_log_factor - log_sum(rivals)
        if load_log_factor < self._threshold or log_odds < STRONG_EVIDENCE_NATS:
            return False
        change = _DatedChange.most_likely(changes, windows, load_log_factors)
        causes = cause_probabilities(evidence, is_lasting)
        self._renew_reference(change, float(log_odds), causes)
        return True

    def _test_for_stale_reference(
        self, windows: Windows, changes: WindowChanges, evidence: CauseEvidence
    ) -> None:
        """Tests whether anything has changed, at least ``STALE_SECONDS`` ago, and renews the reference if so.

        Flight before such a change cannot be compared with later flight, even if the cause is unknown. The change is
        recorded only if it is strong evidence for a change in roll and pitch, which a shifted load and a weak motor
        both make. A change in yaw alone is not recorded.

        Args:
            windows: (w,) lengths of the windows, in blocks.
            changes: Change of the balance for each window.
            evidence: Logarithms of the Bayes factors of all causes, some of them by window.
        """
        is_lasting = windows * BLOCK_SECONDS >= STALE_SECONDS
        # (w,) by window, for all causes that change roll and pitch, and for all causes.
        tilt_log_factors = log_sum(
            [
                evidence.all_axes_log_factors,
                evidence.load_log_factors,
                *evidence.motor_log_factors_by_window,
            ]
        )
        any_log_factors = log_sum([evidence.yaw_log_factors, tilt_log_factors])
        any_log_factors = _of_lasting_windows(any_log_factors, is_lasting)
        if any_log_factors.max() < self._threshold:
            return
        change = _DatedChange.most_likely(changes, windows, any_log_factors)
        # The rivals are a change in yaw alone, and no change at all, with a Bayes factor of 1.
        rivals = [log_sum(evidence.yaw_log_factors), 0.0]
        tilt_log_factor = log_sum(_of_lasting_windows(tilt_log_factors, is_lasting))
        log_odds_of_tilt = tilt_log_factor - log_sum(rivals)
        causes = cause_probabilities(evidence, is_lasting)
        self._renew_reference(change, float(log_odds_of_tilt), causes)

    def _renew_reference(
        self, change: _DatedChange, log_odds: float, causes: CauseProbabilities
    ) -> None:
        """Makes the blocks since a change of the torque the reference for later flight; the earlier ones are dropped.

        The change is recorded too if its odds are strong evidence, and no turn of the vehicle in wind explains it.

        Args:
            change: The change of the balance.
            log_odds: Logarithm of the odds that something changed in roll and pitch.
            causes: What may have changed it.
        """
        block_count = change.block_count
        if log_odds >= STRONG_EVIDENCE_NATS and self._is_independent_of_heading(change):
            # Recording the change dates its beginning more closely.
            block_count = self._add_torque_change(change, log_odds, causes)
        self._blocks.keep_last(block_count)

    def _add_torque_change(
        self, change: _DatedChange, log_odds: float, causes: CauseProbabilities
    ) -> int:
        """Records a change of the balance in roll and pitch that names no motor, and dates its beginning.

        Args:
            change: The change of the balance.
            log_odds: Logarithm of the odds that something changed in roll and pitch.
            causes: What may have changed it.

        Returns:
            Number of blocks since the change began.
        """
        block_count = _blocks_since_change(np.array(self._blocks.balances), change)
        size = float(np.linalg.norm(change.size * self._model.tilt_axes))
        no_motor = None
        suspect = self._suspected_motor(change, causes)
        self._add_alarm(no_motor, block_count, log_odds, size, causes=causes, suspect=suspect)
        return block_count

    def _suspected_motor(
        self, change: _DatedChange, causes: CauseProbabilities
    ) -> SuspectedMotor | None:
        """Returns the motor that probably caused a change of the torque, with the rise of its command.

        The evidence for it is too weak for an alarm, but its probability is at least that from which a motor is named
        in a comparison of flights, too (``MIN_NAMED_PROBABILITY``).

        Args:
            change: The change of the balance.
            causes: What may have changed it.

        Returns:
            The motor; None if none is probable enough.
        """
        if causes.likeliest_motor_probability < MIN_NAMED_PROBABILITY:
            return None
        motor = causes.likeliest_motor
        balance_before = np.mean(self._blocks.balances[: -change.block_count], axis=0)
        no_weak_motor: dict[int, float] = {}
        # Of the sizes of the hypothesis any will do: only the ratios between the motors matter.
        rises = hypothetical_rises(len(self._geometry.names), no_weak_motor)[motor, -1]
        estimate = self._model.estimated_rises(
            rises, balance_before, balance_before + change.size, change.variance
        )
        return SuspectedMotor(
            name=self._geometry.names[motor],
            probability=causes.likeliest_motor_probability,
            rise=float(estimate.rises[motor]),
        )

    def _is_independent_of_heading(self, change: _DatedChange) -> bool:
        """Returns whether a change shows at each heading, so that no turn of the vehicle in wind explains it.

        It is False before ``MIN_STEADY_SECONDS`` of flight at steady headings, when it cannot be decided.

        Args:
            change: Change of the balance, with the time of its beginning.
        """
        if self._blocks.steady_count * BLOCK_SECONDS < MIN_STEADY_SECONDS:
            return False
        return is_independent_of_heading(
            np.array(self._blocks.balances),
            np.array(self._blocks.headings),
            change.block_count,
            change.size,
            change.variance,
        )

    def _record_motor_change(self, rises: Array, change: _DatedChange, log_odds: float) -> None:
        """Records the loss or the recovery of one motor, or the recovery of several, and makes a new reference.

        A weak motor needs a higher command for the same thrust. Its rise is the relative increase of its command since
        it was sound, so that the rise before this change counts too (:func:`_total_rise`). A recovered motor is
        recorded as sound, with size 0, if several recover together or if the rise that remains is within the error of
        the rise before. Of any other motor, the rise and the interval of the lost thrust are recorded.

        Args:
            rises: (k,) rises of the motors' commands under the cause that was found, in their ratio to each other: 0
                for motors that did not change, negative for motors that recovered.
            change: The change of the balance.
            log_odds: Logarithm of the odds that this is the cause.
        """
        block_count = change.block_count
        balance_before = np.mean(self._blocks.balances[-block_count:], axis=0) - change.size
        # The block in which the change began is partly from before it, and is left out.
        balance_after = np.mean(self._blocks.balances[1 - block_count :], axis=0)
        estimate = self._model.estimated_rises(
            rises, balance_before, balance_after, change.variance
        )
        moved_motors = np.flatnonzero(rises).tolist()
        # A later change of a motor that is weak already is not evidence about its first loss.
        self._unconfirmed_loss = None
        for motor in moved_motors:
            previous_alarm = self.weak_motors.pop(motor, None)
            previous_rise = 0.0 if previous_alarm is None else previous_alarm.size
            # The rise since the motor was sound, with both ends of its 90 % interval.
            change_of_command = float(estimate.rises[motor])
            half_width = float(estimate.half_widths[motor])
            rise = _total_rise(previous_rise, change_of_command)
            lowest_rise = _total_rise(previous_rise, change_of_command - half_width)
            highest_rise = _total_rise(previous_rise, change_of_command + half_width)
            is_sound_again = rise < max(RISES[0], previous_rise * MAX_RECOVERED_FRACTION)
            if rises[motor] < 0 and (len(moved_motors) > 1 or is_sound_again):
                self._add_alarm(motor, block_count, log_odds, 0.0)
                continue
            loss = self._model.thrust_loss(motor, max(lowest_rise, 0.0), highest_rise)
            alarm = self._add_alarm(motor, block_count, log_odds, max(rise, RISES[0]), loss)
            self.weak_motors[motor] = alarm
            if previous_alarm is None:
                self._unconfirmed_loss = LossConfirmation(
                    motor,
                    start=alarm.onset_time,
                    detection=alarm.time,
                    balance_before=balance_before,
                    change=balance_after - balance_before,
                    variance=change.variance,
                )
        # From now on, flight is compared with that since the change, once the vehicle has settled. The noise before the
        # change is the prior of the noise after it.
        self._blocks.keep_last(block_count - SETTLING_BLOCKS)
        self._noise_variance = change.changes.block_variance[change.window]
        self._degrees_of_freedom = min(change.changes.freedom[change.window], MAX_PRIOR_FREEDOM)

    def _add_alarm(
        self,
        motor: int | None,
        block_count: int,
        log_odds: float,
        size: float,
        loss: Numbers = (),
        causes: CauseProbabilities | None = None,
        suspect: SuspectedMotor | None = None,
    ) -> MotorChange:
        """Adds a change to the alarms, as detected with the last block of samples.

        Args:
            motor: Index of the motor; None if the change is of the torque, and of no single motor.
            block_count: Number of blocks since the change began.
            log_odds: Logarithm of the odds that the balance changed so, from which the probability follows.
            size: Rise of the motor's command, or size of the change of the torque.
            loss: Interval of the thrust that the motor lost, as fractions; empty if it lost none.
            causes: What may have changed the torque, where no motor is named.
            suspect: The motor that probably changed the torque, where no motor is named; None without one.

        Returns:
            The change as an alarm.
        """
        geometry = self._geometry
        motor_number = None
        motor_name = ""
        if motor is not None:
            motor_number = geometry.motors[motor]
            motor_name = geometry.names[motor]
        alarm = MotorChange(
            time=self._blocks.times[-1],
            onset_time=self._blocks.start_of_last(block_count),
            motor=motor_number,
            name=motor_name,
            size=size,
            # The logistic function converts log odds to a probability.
            probability=1 / (1 + np.exp(-log_odds)),
            assumed=geometry.positions_assumed,
            boot=self._boot,
            loss=loss,
            cause_probabilities=causes,
            suspect=suspect,
        )
        self.alarms.append(alarm)
        return alarm


def _blocks_since_change(balances: Array, change: _DatedChange) -> int:
    """Returns how many blocks ago a change of the balance began, more precisely than by the window that detected it.

    The lengths of the windows differ by seconds. So the beginning is dated anew, at the block that divides the blocks
    into two parts with the most significant difference of their means. This is the maximum likelihood estimate of a
    change point in independent normal noise.

    Args:
        balances: balance about each axis in N blocks (N, a), the latest last.
        change: the change of the balance, with the length of its window in blocks.

    Returns:
        The number of blocks since the change began.
    """
    count = len(balances)
    # Balances less their mean, in standard errors of the change.
    scaled = (balances - balances.mean(axis=0)) / np.sqrt(change.variance)
    # Possible numbers of blocks since the change began. The next shorter window is about half as long as that of the
    # change, and the next longer one twice as long.
    shortest = change.block_count // 2
    longest = min(2 * change.block_count, count - 1)
    candidates = np.arange(shortest, longest + 1)
    # Row n − 1 of the cumulative sums, backward in time, is the sum of the last n blocks.
    sums_since = np.cumsum(scaled[::-1], axis=0)[candidates - 1]
    # With n blocks since the change and m before, the log likelihood is n m / (n + m) times half of the squared
    # difference of their means, summed over the axes. As all blocks have the mean 0, the sum of those before is the
    # negative of the sum s of those since, and the difference of the means is s (n + m) / (n m). So the log likelihood
    # is proportional to s² (n + m) / (n m).
    blocks_before = count - candidates
    log_likelihoods = (sums_since**2).sum(axis=1) * count / (candidates * blocks_before)
    return int(candidates[np.argmax(log_likelihoods)])


def _total_rise(earlier_rise: float, later_rise: float) -> float:
    """Returns the relative rise of a motor's command over two changes, whose factors 1 + rise multiply.

    Args:
        earlier_rise: relative rise by the first change; 0 if there was none.
        later_rise: relative rise by the second change, over the command after the first one.
    """
    return (1 + earlier_rise) * (1 + later_rise) - 1
