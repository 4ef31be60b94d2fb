"""Sequential detection of a motor that loses thrust in flight: which one works harder than before, lastingly.

docs/motors.md says what is compared with what. The hypotheses exclude each other: nothing changed; motor i works
harder, by 5 to 80 %, which shows as its signature; the steady torque in roll and pitch changed; that in yaw alone did;
all three did, of any cause; and once motors are weak, one of them recovers, or all of them do. Each hypothesis has a
Bayes factor against "nothing changed", a mixture over the size of the change. Summed over the times at which the change
may have begun, they are a Shiryaev-Roberts statistic. Were the noise known, the mean time to a false alarm would be at
least A steps for a threshold of A (M. Pollak, "Optimal detection of a change in distribution", Annals of Statistics
1985; with mixtures: J. Shin, A. Ramdas and A. Rinaldo, "E-detectors", New England Journal of Statistics in Data Science
2024). The variance is estimated here, and the largest of several is taken, so the threshold is a design value and no
bound; ``FALSE_ALARMS`` has what was measured. Which change it is, is decided by the Bayes factors against each other,
as in S. Dayanik, C. Goulding and H. V. Poor, "Bayesian sequential change diagnosis", Mathematics of Operations Research
2008.

After a change, the balance that it left is the reference, and the noise before it is the prior of the noise after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, inf, log, nan
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import STRONG_EVIDENCE_NATS, coverage_factor
from mavdem.containers import Numbers
from mavdem.dataset.phases import TRANSIENT_SECONDS
from mavdem.dataset.steady_flight import MAX_HEADING_CHANGE
from mavdem.facts import Fact
from mavdem.facts.motors import InFlight
from mavdem.ingest.motors import MotorGeometry
from mavdem.motors.balance import MIN_STEADY_SECONDS
from mavdem.motors.change_causes import (
    RISES,
    CauseEvidence,
    can_reach_threshold,
    cause_evidence,
    log_sum,
)
from mavdem.motors.change_statistics import (
    BLOCK_SECONDS,
    PRIOR_FREEDOM,
    WindowChanges,
    Windows,
    log_t_density,
    window_changes,
)
from mavdem.motors.heading_sectors import heading_change, is_independent_of_heading
from mavdem.motors.motor_changes import THRUST_EXPONENTS, MotorAlarm
from mavdem.motors.signatures import motor_signatures
from mavdem.motors.thrust_loss import lost_thrust

MIN_BLOCK_SAMPLES = 3
"""Number of samples that a block must have."""

MIN_SAMPLE_RATE = MIN_BLOCK_SAMPLES / BLOCK_SECONDS
"""Rate of the samples, Hz, that the detection needs."""

SAMPLE_RATE_TOLERANCE = 0.9
"""Share of that rate which is still enough, for jitter."""

MIN_PRESENT_SHARE = 0.8
"""Share of the blocks that must be present: where more are missing, changes are not tested for. A choice."""

REFERENCE_SECONDS = 8.0
"""Seconds of flight that must precede the first change, and that a change in roll and pitch alone must last.

A gust is over by then.
"""

NEXT_REFERENCE_SECONDS = 2.0
"""Seconds of flight that must precede another change: by then the noise is known."""

KEPT_SECONDS = 150.0
"""Seconds of flight that are remembered; a choice, a few times the memory of the reference."""

MAX_GAP = TRANSIENT_SECONDS
"""Seconds without settled flight after which what was before is no reference: no landing with take-off is shorter."""

SETTLING_BLOCKS = 2
"""Number of blocks after a motor's change in which the vehicle settles, and which are no reference."""

WINDOW_BLOCKS = (2, 3, 4, 6, 8, 10, 14, 20, 30, 40)
"""Numbers of blocks since the change began, for which it is tested; a choice."""

STALE_SECONDS = 15.0
"""Seconds after which a change of any cause makes what was before no reference."""

HOURS_TO_FALSE_ALARM = 10.0
"""Mean time to a false alarm by design, hours."""

MAX_RECOVERED_SHARE = 1 / 4
"""Share of its former rise below which a motor's remaining rise counts as recovered: the rise may be wrong by it."""

PRIOR_BLOCK_SD = 0.006
"""Standard deviation of a block's balance before the flight has shown its own, relative to the mean command."""

MAX_PRIOR_FREEDOM = 60.0
"""Degrees of freedom, at most, of the noise before a change as a prior of that after it: those of a whole reference."""

OTHERS_PER_LOAD = 0.05
"""Prior odds of a change that is neither a motor's nor in roll and pitch alone, against one in roll and pitch.

A load that shifts in wind changes yaw too.
"""

OTHERS_PER_MOTOR = 0.1
"""Prior odds of such a change against one of a motor. They are high: the worst mistake is to name a sound motor."""

SETTLING_ERROR = 0.04
"""Standard error of a motor's rise a second after it began, as a fraction of it: yaw settles last."""

TOO_SLOW = Fact(InFlight.MOTOR_OUTPUTS_TOO_SLOW, needed_rate=MIN_SAMPLE_RATE)
"""Obstacle where motor outputs come too slowly."""


class _RiseEstimate(NamedTuple):
    """Estimated rise of each of k motors' commands in a change, as a fraction of the command before it."""

    rises: Array
    """(k,) rises; 0 of motors that the change does not concern."""
    half_widths: Array
    """(k,) half widths of their 90 % intervals."""


class MotorLossDetector:
    """Sequential test, block by block in flight, of whether the balance of one vehicle's motors changed in one boot.

    Attributes:
        alarms: Changes that were detected so far.
        weak_motors: Latest alarm on each motor that has not recovered, by its index; empty after a gap of ``MAX_GAP``.
        latest_time: Time of the last sample, s.
        reference_time: Since when there is enough flight to compare with, s; None without.
        obstacle: Why no change can be detected; None where it can. It is known after a few seconds of settled flight.
    """

    def __init__(self, geometry: MotorGeometry, boot: int = 0) -> None:
        """Begins the test.

        Args:
            geometry: Positions and spins of the vehicle's k motors.
            boot: Number of the vehicle's boot, from 0.
        """
        self.alarms: list[MotorAlarm] = []
        self.weak_motors: dict[int, MotorAlarm] = {}
        self.latest_time = -inf
        self.reference_time: float | None = None
        signatures = motor_signatures(geometry)
        self._is_identifiable = signatures.is_motor_identifiable
        self.obstacle = None if self._is_identifiable else Fact(InFlight.MOTOR_PLACES_UNKNOWN)
        self._geometry = geometry
        self._boot = boot
        self._threshold = log(HOURS_TO_FALSE_ALARM * 3600 / BLOCK_SECONDS)

        # Rows (a, k) of the mixer without thrust turn commands of motors into torque commands of the a axes.
        self._torque_rows = signatures.mixer_rows[1:]
        # A motor that must work harder by 1 raises its own command by this ratio (k,), since its neighbours help it.
        self._own_rise_ratio = np.diag(signatures.weak_motor_commands)
        # The balance changes by these rows (k, a) where the own command of a motor rises by 1.
        self._signatures = self._torque_rows.T / self._own_rise_ratio[:, None]
        # The allocation (k, 1 + a) turns thrust and torque commands into commands of motors.
        self._allocation = np.linalg.pinv(signatures.mixer_rows)
        # A shifted load or wind changes roll and pitch, which have a 1 in this vector (a,), and not yaw, which has a 0.
        is_tilt_axis = [axis != "yaw" for axis in signatures.axes[1:]]
        self._tilt_axes = np.array(is_tilt_axis, dtype=np.float64)

        # Each block since the last gap has its end, s, its balance (a,) and its heading, rad, which is NaN in turns.
        self._times: list[float] = []
        self._blocks: list[Array] = []
        self._headings: list[float] = []
        self._steady_blocks = 0
        # The long-run variance (a,) of a block has this prior, with its degrees of freedom.
        self._noise = np.full(len(self._torque_rows), PRIOR_BLOCK_SD**2)
        self._freedom = PRIOR_FREEDOM
        # The block that is being filled has a number, commands, and the heading at its start.
        self._block_number = 0
        self._block_commands: list[Any] = []
        self._block_heading = nan
        # Samples are counted from a time on, s, to know their rate.
        self._count_start = -inf
        self._sample_count = 0

    def update(
        self, time: float, commands: Sequence[float] | Array, heading: float = 0.0
    ) -> list[MotorAlarm]:
        """Takes a sample of settled flight, and tests for a change whenever a block of samples is complete.

        Samples are averaged over blocks of ``BLOCK_SECONDS`` of the clock, which takes out fast noise. The first sample
        of a new block closes the one before. If that has enough samples, it is added to the flight and tested. After a
        gap of ``MAX_GAP``, or if the clock goes back by as much, the test begins anew.

        Args:
            time: Seconds on the clock of the boot.
            commands: (k,) motor outputs as fractions of the range.
            heading: Heading, rad; NaN where the attitude does not follow its setpoint.

        Returns:
            The changes that are detected with this sample.
        """
        if not self._is_identifiable:
            return []
        step = time - self.latest_time
        if -MAX_GAP < step <= 0:
            # A doubled or overtaken message: the mean of a block does not need it.
            return []
        # After a landing, or with another clock, flight before is no reference.
        if not 0 < step < MAX_GAP:
            self._restart(time, heading)
        self.latest_time = time
        self._check_sample_rate(time)
        alarm_count = len(self.alarms)
        block_number = floor(time / BLOCK_SECONDS)
        if block_number != self._block_number:
            if len(self._block_commands) >= MIN_BLOCK_SAMPLES:
                block_end = (self._block_number + 1) * BLOCK_SECONDS
                mean_commands = np.mean(self._block_commands, axis=0)
                self._add_block(block_end, mean_commands, heading)
            self._block_heading = heading
            self._block_number = block_number
            self._block_commands = []
        self._block_commands.append(commands)
        return self.alarms[alarm_count:]

    def _restart(self, time: float, heading: float) -> None:
        """Forgets all flight before a gap, with its reference, noise and weak motors, as after a landing.

        Args:
            time: Time of the next sample, s.
            heading: Heading at that sample, rad.
        """
        self._times = []
        self._blocks = []
        self._headings = []
        self._steady_blocks = 0
        self._noise = np.full(len(self._torque_rows), PRIOR_BLOCK_SD**2)
        self._freedom = PRIOR_FREEDOM
        self.reference_time = None
        self.weak_motors.clear()
        self._block_number = floor(time / BLOCK_SECONDS)
        self._block_commands = []
        self._block_heading = heading
        self._count_start = time
        self._sample_count = 0

    def _check_sample_rate(self, time: float) -> None:
        """Counts a sample, and decides every ``REFERENCE_SECONDS`` whether samples come fast enough.

        If they do not, ``obstacle`` says so until they do.

        Args:
            time: Time of the sample, s.
        """
        elapsed = time - self._count_start
        if elapsed >= REFERENCE_SECONDS:
            min_samples = SAMPLE_RATE_TOLERANCE * MIN_SAMPLE_RATE * elapsed
            self.obstacle = TOO_SLOW if self._sample_count <= min_samples else None
            self._count_start = time
            self._sample_count = 0
        self._sample_count += 1

    def _add_block(self, time: float, commands: Array, heading: float) -> None:
        """Adds a block, ``BLOCK_SECONDS`` of flight, and tests whether the motors' balance changed lately.

        The balance is the torque about each axis that the motors' commands make, relative to their mean. The block's
        heading is stored too, to tell later whether wind explains a change; in a turn it is NaN. Then the test is run
        with windows of several lengths, each one assumption on how many blocks ago a change began. A window is used
        only if enough flight precedes it to compare with. There is no test while too many blocks are missing.

        Args:
            time: End of the block, s.
            commands: (k,) mean motor outputs as fractions of the range.
            heading: Heading at its end, rad.
        """
        # The mean command stands for the thrust. Motors that stand still have no balance.
        thrust = commands.mean()
        if not thrust > 0:
            return
        # The balance is relative to the thrust, so that neither battery nor climb changes it.
        self._times.append(time)
        self._blocks.append(self._torque_rows @ (commands / thrust))
        # A block is steady if the heading turned slower than MAX_HEADING_CHANGE, rad/s; NaN headings are not steady.
        turn = heading_change(heading, self._block_heading)
        is_steady = abs(turn) <= MAX_HEADING_CHANGE * BLOCK_SECONDS
        self._headings.append(heading if is_steady else nan)
        if is_steady:
            self._steady_blocks += 1
        self._keep_last_blocks(round(KEPT_SECONDS / BLOCK_SECONDS))

        # With too many blocks missing, as after lost messages, the variances would be wrong.
        expected_blocks = (self._times[-1] - self._times[0]) / BLOCK_SECONDS + 1
        if len(self._blocks) < MIN_PRESENT_SHARE * expected_blocks:
            return
        # After a motor's change, the noise before it is the prior, with more degrees of freedom than at the beginning.
        # So the noise is known already, and a shorter reference is enough.
        has_changed_before = self._freedom > PRIOR_FREEDOM
        reference_seconds = NEXT_REFERENCE_SECONDS if has_changed_before else REFERENCE_SECONDS
        reference_blocks = reference_seconds / BLOCK_SECONDS
        windows = [
            length for length in WINDOW_BLOCKS if len(self._blocks) >= length + reference_blocks
        ]
        if windows:
            self.reference_time = self.reference_time or time
            self._test_for_change(np.array(windows, dtype=int))

    def _test_for_change(self, windows: Windows) -> None:
        """Tests whether the motors' balance changed within the last blocks, and records the change of a motor if so.

        Every cause has a Bayes factor: how much better it explains the change than "nothing changed" does. Here they
        are logarithms, so that products are sums. The causes are the loss or recovery of each motor, a load (a change
        in roll and pitch alone), and other changes, as in yaw alone. The steps are:

        1. Stop if the change is too small for any cause.
        2. Take the motor's cause with the largest Bayes factor. It must reach the threshold, which keeps false alarms
           rare, and its odds against all other causes together must be strong, so that no sound motor is named.
        3. Record it, unless a turn of the vehicle in wind explains it.
        4. If no motor's cause passes step 2, test whether a load or something unknown changed the torque.

        Args:
            windows: (w,) lengths of the windows, in blocks: the change may have begun so many blocks ago.
        """
        changes = window_changes(np.array(self._blocks), windows, self._noise, self._freedom)
        no_change = log_t_density(changes, 0.0)
        motor_causes = len(self._signatures) + len(self.weak_motors)
        if not can_reach_threshold(changes, no_change, motor_causes, self._threshold):
            return
        weak_motor_sizes = {motor: alarm.size for motor, alarm in self.weak_motors.items()}
        evidence = cause_evidence(
            changes, no_change, self._signatures, self._tilt_axes, weak_motor_sizes
        )
        # The odds of the best cause are its Bayes factor over the sum of those of all the others.
        best = int(np.argmax(evidence.motors))
        other_motors = np.delete(evidence.motors, best)
        rivals = [*other_motors, log_sum(evidence.load)]
        # The last rival is that nothing changed, with a Bayes factor of 1.
        rivals += [evidence.others + log(OTHERS_PER_MOTOR), 0.0]
        log_odds = evidence.motors[best] - log_sum(rivals)
        is_enough = evidence.motors[best] >= self._threshold
        if is_enough and log_odds >= STRONG_EVIDENCE_NATS:
            # The window in which the cause explains the change best tells when the change began.
            window = int(np.argmax(evidence.motor_windows[best]))
            blocks_since = int(windows[window])
            if self._is_independent_of_heading(blocks_since, changes, window):
                # The last size is the largest. Only the ratios between the motors matter.
                largest_rises = evidence.rises[best, -1]
                self._record_motor_change(largest_rises, blocks_since, changes, window, log_odds)
            return
        self._test_for_torque_change(windows, changes, evidence)

    def _test_for_torque_change(
        self, windows: Windows, changes: WindowChanges, evidence: CauseEvidence
    ) -> None:
        """Tests whether something other than a motor, as a shifted load, changed the steady torque.

        The reference is the flight before a change, which later flight is compared with. Two cases end it:

        1. A change in roll and pitch alone, called load, that has lasted ``REFERENCE_SECONDS``, longer than a gust. Its
           Bayes factor must reach the threshold, and its odds against all other causes must be strong evidence. It is
           recorded, unless a turn of the vehicle in wind explains it.
        2. A change of any cause, even an unknown one, that has lasted ``STALE_SECONDS``. It is not recorded, but flight
           before it is no longer comparable.

        In both cases only the blocks since the change are kept, and are the new reference.

        Args:
            windows: (w,) lengths of the windows, in blocks: the change may have begun so many blocks ago.
            changes: Change of the balance for each window.
            evidence: Logarithms of the Bayes factors of all causes, some of them by window.
        """
        seconds = windows * BLOCK_SECONDS
        # Windows that are too short get a Bayes factor of 0, whose logarithm is -inf, and so count for nothing.
        lasting_load = evidence.load + np.where(seconds >= REFERENCE_SECONDS, 0.0, -inf)
        load = log_sum(lasting_load)
        # The last rival is that nothing changed, with a Bayes factor of 1.
        rivals = [*evidence.motors, evidence.others + log(OTHERS_PER_LOAD), 0.0]
        log_odds = load - log_sum(rivals)
        # (w,) the sum of the Bayes factors of all causes, by window.
        any_cause = log_sum(
            [evidence.yaw, evidence.all_axes, evidence.load, *evidence.motor_windows]
        )
        stale_change = np.where(seconds >= STALE_SECONDS, 0.0, -inf) + any_cause
        if load >= self._threshold and log_odds >= STRONG_EVIDENCE_NATS:
            window = int(np.argmax(lasting_load))
            blocks_since = int(windows[window])
            size = float(np.linalg.norm(changes.change[window] * self._tilt_axes))
            if self._is_independent_of_heading(blocks_since, changes, window):
                self._record(None, blocks_since, log_odds, size)
        elif stale_change.max() >= self._threshold:
            blocks_since = int(windows[np.argmax(stale_change)])
        else:
            return
        # From now on, flight is compared with that since the change.
        self._keep_last_blocks(blocks_since)

    def _is_independent_of_heading(
        self, blocks_since: int, changes: WindowChanges, window: int
    ) -> bool:
        """Returns whether a change holds at each heading, so that no turn of the vehicle in wind explains it.

        It is not known, and so denied, before ``MIN_STEADY_SECONDS`` of flight at steady headings.

        Args:
            blocks_since: Number of blocks since the change began.
            changes: Change of the balance for each window.
            window: Index of the window of that length.
        """
        if self._steady_blocks * BLOCK_SECONDS < MIN_STEADY_SECONDS:
            return False
        return is_independent_of_heading(
            np.array(self._blocks),
            np.array(self._headings),
            blocks_since,
            changes.change[window],
            changes.variance[window],
        )

    def _record_motor_change(
        self,
        rises: Array,
        blocks_since: int,
        changes: WindowChanges,
        window: int,
        log_odds: float,
    ) -> None:
        """Records the loss or the recovery of one motor, or the recovery of several, and makes a new reference.

        A weak motor needs a higher command for the same thrust. Its rise is the relative increase of its command since
        it was sound. So the rise before this change and that by the change multiply:
        1 + rise = (1 + rise before) (1 + rise by the change). A recovered motor is recorded as sound, with size 0, if
        several recover together or if the rise that remains is within the error of the former one. Of any other motor,
        the rise and the interval of the lost thrust are recorded.

        Args:
            rises: (k,) rises of the motors' commands of the hypothesis, up to their size.
            blocks_since: Number of blocks since the change began.
            changes: Change of the balance for each window.
            window: Index of the window of that length.
            log_odds: Logarithm of the odds that this is the cause.
        """
        estimate = self._estimated_rises(rises, blocks_since, changes, window)
        moved_motors = np.flatnonzero(rises).tolist()
        for motor in moved_motors:
            previous = self.weak_motors.pop(motor, None)
            previous_rise = 0.0 if previous is None else previous.size
            # The estimate of the rise with both ends of its 90 % interval.
            lowest, rise, highest = (
                (1 + previous_rise)
                * (1 + estimate.rises[motor] + sign * estimate.half_widths[motor])
                - 1
                for sign in (-1, 0, 1)
            )
            is_sound_again = rise < max(RISES[0], previous_rise * MAX_RECOVERED_SHARE)
            if rises[motor] < 0 and (len(moved_motors) > 1 or is_sound_again):
                self._record(motor, blocks_since, log_odds, 0.0)
            else:
                loss = self._thrust_loss(motor, max(lowest, 0.0), highest)
                rise = max(rise, RISES[0])
                self.weak_motors[motor] = self._record(motor, blocks_since, log_odds, rise, loss)
        # From now on, flight is compared with that since the change, once the vehicle has settled. The noise before the
        # change is the prior of the noise after it.
        self._keep_last_blocks(blocks_since - SETTLING_BLOCKS)
        self._noise = changes.noise[window]
        self._freedom = min(changes.freedom[window], MAX_PRIOR_FREEDOM)

    def _estimated_rises(
        self, rises: Array, blocks_since: int, changes: WindowChanges, window: int
    ) -> _RiseEstimate:
        """Returns by how much the motors' commands rose in a change, relative to what they were before it.

        The size of the change is the weighted least-squares estimate along its signature: with balance before and
        after it b₀ and b₁, signature g and variance V, it is gᵀ V⁻¹ (b₁ − b₀) / (gᵀ V⁻¹ g).

        The signature is the change of the balance that a change of size 1, all of ``rises``, would make. The balance is
        relative to the mean command, which itself rises by mean_rise: so the signature is less by mean_rise · b₁.

        Args:
            rises: (k,) rises of the motors' commands of the hypothesis, up to their size.
            blocks_since: Number of blocks since the change began.
            changes: Change of the balance for each window.
            window: Index of the window of that length.
        """
        balance_before = np.mean(self._blocks[-blocks_since:], axis=0) - changes.change[window]
        # The block in which the change began is partly from before it, and is left out.
        balance_after = np.mean(self._blocks[1 - blocks_since :], axis=0)
        mean_rise = (rises / self._own_rise_ratio).mean()
        signature = rises @ self._signatures - mean_rise * balance_after
        weighted_signature = signature / changes.variance[window]
        precision = weighted_signature @ signature
        # Commands before the change, relative to their mean: thrust 1 and the balance.
        commands = self._allocation @ [1.0, *balance_before]
        relative_rises = rises / commands
        estimates = (
            weighted_signature @ (balance_after - balance_before) / precision * relative_rises
        )
        # Two independent errors: that of least squares, and that of a vehicle that has not settled yet.
        standard_errors = np.hypot(precision**-0.5 * relative_rises, SETTLING_ERROR * estimates)
        return _RiseEstimate(estimates, coverage_factor() * standard_errors)

    def _thrust_loss(self, motor: int, lowest_rise: float, highest_rise: float) -> Numbers:
        """Returns the interval of the fraction of its thrust that a motor lost, for all ``THRUST_EXPONENTS``.

        The interval is as wide as what is not known: how far the command rose, and with which power of it thrust goes.
        On vehicles whose neighbours help a weak motor, its own command rises by less than it lacks: so the loss is
        divided by that ratio. Nothing loses more than all its thrust.

        Args:
            motor: Index of the motor.
            lowest_rise: Lower end of the interval of its command's rise, as a fraction.
            highest_rise: Upper end.

        Returns:
            Lower and upper end, fractions of the thrust.
        """
        smallest_exponent, largest_exponent = THRUST_EXPONENTS
        own_rise_ratio = self._own_rise_ratio[motor]
        smallest_loss = lost_thrust(lowest_rise, smallest_exponent) / own_rise_ratio
        largest_loss = lost_thrust(highest_rise, largest_exponent) / own_rise_ratio
        return min(smallest_loss, 1.0), min(largest_loss, 1.0)

    def _record(
        self,
        motor: int | None,
        blocks_since: int,
        log_odds: float,
        size: float,
        loss: Numbers = (),
    ) -> MotorAlarm:
        """Adds a change to the alarms, as detected with the last block.

        Args:
            motor: Index of the motor; None where the change is no motor's.
            blocks_since: Number of blocks since the change began.
            log_odds: Logarithm of the odds that this is the cause.
            size: Rise of the motor's command, or size of the change of the torque.
            loss: Interval of the thrust that the motor lost.
        """
        geometry = self._geometry
        alarm = MotorAlarm(
            time=self._times[-1],
            since=self._times[-blocks_since] - BLOCK_SECONDS,
            motor=None if motor is None else geometry.motors[motor],
            name="" if motor is None else geometry.names[motor],
            size=size,
            probability=1 / (1 + np.exp(-log_odds)),
            assumed=geometry.positions_assumed,
            boot=self._boot,
            loss=loss,
        )
        self.alarms.append(alarm)
        return alarm

    def _keep_last_blocks(self, count: int) -> None:
        """Forgets all blocks but the last ``count``."""
        excess = max(len(self._times) - count, 0)
        del self._times[:excess]
        del self._blocks[:excess]
        del self._headings[:excess]
