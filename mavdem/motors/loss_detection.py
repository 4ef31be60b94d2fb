"""Motors in flight: a sequential test of their balance finds which works harder than before, lastingly.

docs/motors.md says what is compared with what. Hypotheses exclude each other: nothing changed; motor i works harder, by
5 to 80 %, which shows as its signature; the steady torque in roll and pitch changed; that in yaw alone did; all three
did, of any cause; and once motors are weak, one of them gives more thrust again, or all of them do. Each hypothesis has
a Bayes factor against "nothing changed", a mixture over the size of the change. Summed over the times at which the
change may have begun they are a Shiryaev–Roberts statistic. Were the noise known, the mean time to a false alarm would
be A steps at least where it must reach A (M. Pollak, "Optimal detection of a change in distribution", Annals of
Statistics 1985; with mixtures: J. Shin, A. Ramdas and A. Rinaldo, "E-detectors", New England Journal of Statistics in
Data Science 2024). Its variance is estimated here, and the larger of several is taken, so that the ten hours that A is
set for are a design value and no bound. What was measured, ``FALSE_ALARMS`` says. Which change it is, is
decided by the Bayes factors against each other, as in S. Dayanik, C. Goulding and H. V. Poor, "Bayesian sequential
change diagnosis", Mathematics of Operations Research 2008.

The noise's long-run variance is estimated, and the factors are those of a t distribution. After a change the balance
that it left is the reference, and the noise before it the prior of what follows. ``MotorWatch`` applies the test over a
vehicle's settled flight, and says in a sentence what changed for good.
"""

from collections.abc import Sequence
from math import floor, inf, log, nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Flags
from mavdem.confidence import STRONG_EVIDENCE_NATS, Interval, coverage_factor
from mavdem.containers import JsonValues, Numbers
from mavdem.dataset.phases import TRANSIENT_SECONDS
from mavdem.dataset.steady_flight import MAX_HEADING_CHANGE
from mavdem.facts import Fact, Level
from mavdem.facts.motors import InFlight
from mavdem.facts.session import Session
from mavdem.ingest.motors import MotorGeometry
from mavdem.motors.balance import LEAST_SECONDS, motor_signatures
from mavdem.motors.health import lost_thrust

Places = NDArray[np.int_]
_log_sum = np.logaddexp.reduce  # logarithm of the sum along the first axis, of logarithms
BLOCK_SECONDS = 0.5  # Of commands that are averaged: a tenth of what a change may take to be found
MIN_SAMPLES = 3  # In a block
MIN_RATE = MIN_SAMPLES / BLOCK_SECONDS  # Hz of the samples
PRESENT_SHARE = 0.8  # Of the blocks, at least: where more are missing, changes are not judged
# Before the first change, at least; and of a change in roll and pitch alone: a gust is over by then
REFERENCE_SECONDS = 8.0
NEXT_REFERENCE_SECONDS = 2.0  # Before another: the noise is known then
SHOWN_SHARE = 0.5  # Of a change, that steady flight of each heading must show
# Headings that differ by less than half of 60° have the wind from much the same side.
SECTORS = 6
SETTLING_BLOCKS = 2  # Since a change of a motor, in which the vehicle settles: no reference
# Over which the reference forgets: wind and battery change, and damage comes at once
MEMORY_SECONDS = 60.0
KEPT_SECONDS = 150.0
# Without settled flight, after which what was before is no reference: no landing and take-off is shorter
LONGEST_GAP = TRANSIENT_SECONDS
CHANGE_BLOCKS = (2, 3, 4, 6, 8, 10, 14, 20, 30, 40)  # Blocks since the change began
BATCHES = (1, 2, 4, 8)  # Blocks whose mean shows the long-run variance
HOURS_TO_FALSE_ALARM = 10.0  # By design
# Of the rise of a motor's own command, as a share of the mean command
SIZES = np.geomspace(0.05, 0.8, 13)
# Of a change in roll, pitch or yaw that is no motor's, as a share of the mean command
OTHER_SD = 0.06
PRIOR_SD = 0.006  # Of half a second's balance, before the flight has shown its own
PRIOR_FREEDOM = 5.0  # Degrees of freedom of that; two blocks each
# Of the noise before a change, as the prior of that after it: as of a whole reference
MOST_FREEDOM = 60.0
WANDER_SD = 0.003  # Of a balance that nothing changed: no mean is known better
OTHERS_BESIDE_LOADS = 0.05
OTHERS_BESIDE_MOTORS = 0.1
"""How often a change that is neither a motor's nor in roll and pitch alone comes, beside those in roll and pitch, and
beside motors: a load that shifts in wind changes yaw too, and to name a sound motor is the worst that can be said."""
STALE_SECONDS = 15.0  # Of any change: then what was before is no reference, whatever the cause
# How often one weak motor recovers, or all do, beside that one more weakens
ENDS_BESIDE_FAULTS = 5.0
# Shares of the rise that end with a fault; a quarter may be an error
RETURNS = np.linspace(0.2, 1.3, len(SIZES))
# Thrust goes with the command (PX4's SIH) up to its square (ArduPilot's SITL at hover)
THRUST_EXPONENTS = 1.0, 2.0
# Standard error of a motor's rise a second after it began, as a share: yaw settles last
SETTLING_ERROR = 0.04


class _Changes(NamedTuple):
    """What changed by window (w,), each since another time."""

    moved: Array  # (w, a) the balance, from before to after
    variance: Array  # (w, a) of that
    freedom: Array  # (w,) degrees of freedom of the variance
    noise: Array  # (w, a) long-run variance of a block, before


def _changes(blocks: Array, windows: Places, prior: Array, freedom: float) -> _Changes:
    """What changed between the ``blocks`` (N, a) before and those of each of the ``windows`` (w,), the last ones.

    ``prior``: long-run variance (a,) of a block, with so many degrees of ``freedom``.
    """
    number = np.arange(len(blocks))
    lengths = windows[:, None]
    is_after = number >= len(blocks) - lengths
    remembered = np.exp(number * (BLOCK_SECONDS / MEMORY_SECONDS))
    weights = np.where(is_after, 0.0, remembered)
    weights /= weights.sum(axis=1, keepdims=True)
    weighed = 1 / (weights**2).sum(axis=1)
    before = weights @ blocks
    after = is_after @ blocks / lengths
    noise = _long_run(blocks, ~is_after, before, prior, freedom)
    noise_after = _long_run(blocks, is_after, after, noise, PRIOR_FREEDOM)
    noise_here = np.maximum(noise, noise_after)
    variance_before = noise / weighed[:, None]
    variance_after = noise_here / lengths
    variance = variance_before + variance_after + WANDER_SD**2
    return _Changes(after - before, variance, freedom + weighed / 4, noise)


def _turn(heading: Any, before: Any) -> Any:
    """The change of a heading, rad, the shorter way round."""
    return (heading - before + np.pi) % (2 * np.pi) - np.pi


def _long_run(blocks: Array, chosen: Flags, mean: Array, prior: Array, freedom: float) -> Array:
    """(w, a) n times the variance of a mean over n blocks, of the run that is ``chosen`` (w, N), about ``mean`` (w, a).

    The ``prior``, (a,) or (w, a), has so many degrees of ``freedom``.
    """
    sums = np.vstack([np.zeros_like(blocks[:1]), np.cumsum(blocks, axis=0)])
    whole = chosen.sum(axis=1, keepdims=True)
    variance = prior
    for batch in (batch for batch in BATCHES if batch <= len(blocks)):
        means = (sums[batch:] - sums[:-batch]) / batch
        begins = chosen[:, : len(means)]
        ends = chosen[:, batch - 1 :]
        inside = begins & ends
        count = inside.sum(axis=1, keepdims=True)
        about_zero = inside @ means**2
        crossed = 2 * mean * (inside @ means)
        squares = about_zero - crossed + count * mean**2
        # Batches overlap: as many count as follow each other.
        several = np.where(count > batch, whole / batch, 0.0)
        held = 2 * freedom / batch
        seen = several * batch * squares / np.maximum(count, 1)
        pooled = (held * prior + seen) / (held + several)
        variance = np.maximum(variance, pooled)
    return variance


def _log_t(changes: _Changes, shift: Array | float, more: Array | float = 0.0) -> Array:
    """(..., w) log densities, up to what depends on the freedom only, of t distributions about ``shift`` (..., w, a).

    ``more``: variance (a,) beside that of the changes.
    """
    variance = changes.variance + more
    errors = changes.moved - shift
    squares = (errors**2 / variance).sum(axis=-1)
    power = (changes.freedom + variance.shape[-1]) / 2
    return -np.log(variance).sum(axis=-1) / 2 - power * np.log1p(squares / changes.freedom)


FALSE_ALARMS = Fact(InFlight.FALSE_ALARMS, duration=5.55 * 3600, alarms_per_hour=0.54)
"""Of 5.55 h of flights without a fault: so many at most, with 95 % confidence (``tools/validation/alarms.py``)."""
TOO_SLOW = Fact(InFlight.MOTOR_OUTPUTS_TOO_SLOW, needed_rate=MIN_RATE)


class MotorAlarm(NamedTuple):
    """A lasting change of the motors' balance in flight."""

    time: float  # s on the boot clock, when it was found
    since: float  # s, when it began, within a second or two
    # number from 1 on; None, which is no alarm: the steady torque in roll and pitch changed, by wind or a shifted load
    motor: int | None
    name: str  # of the motor; empty without one
    # rise of the motor's own command since it was sound, as a share of it: 0 of one that is sound again, which is no
    # alarm; without a motor the change in roll and pitch, as a share of the mean command
    size: float
    probability: float  # that this is the cause, and none of the others that are considered
    assumed: bool = False  # whether the motors' places are assumed, and with them the name
    boot: int = 0  # number of the vehicle's boot, from 0 on, whose clock the times are on
    # interval of 90 % of the share of its thrust that a weak motor lost, for any of ``THRUST_EXPONENTS``
    loss: Numbers = ()

    @property
    def weak(self) -> bool:
        """Whether a motor gives less thrust than before: an alarm."""
        return self.motor is not None and self.size > 0

    @property
    def sound_share(self) -> Interval:
        """The share of its command by which a sound motor would give its thrust, and the half width of 90 %.

        It hardly depends on the exponent: where thrust goes with a power of the command, a loss divides the command.
        """
        ends = zip(self.loss, THRUST_EXPONENTS, strict=True)
        most, least = ((1 - lost) ** (1 / power) for lost, power in ends)
        half_width = abs(most - least) / 2
        return (most + least) / 2, half_width

    @property
    def fact(self) -> Fact:
        """What changed since when, and what that means: bad where a motor lost thrust."""
        code = InFlight.MOTOR_RECOVERED
        if self.motor is None:
            code = InFlight.STEADY_TORQUE_CHANGED
        elif self.weak:
            code = InFlight.MOTOR_LOST_THRUST
        return Fact(
            code,
            time=self.since,
            subject=self.name,
            rise=self.size,
            loss=self.loss,
            probability=self.probability,
            assumed=self.assumed,
            boot=self.boot,
        )

    @property
    def announced(self) -> Fact:
        """The fact, as an alarm where a motor lost thrust."""
        return alarm_of(self.fact, self.since)


def alarm_of(fact: Fact, time: float) -> Fact:
    """Returns a ``fact`` that was found at ``time``, s, as an event: an alarm where it is bad."""
    if fact.is_bad:
        return Fact(Session.ALARM, time=time, subject=fact.subject, because=fact)
    return fact.but(time=time, until=None)


def losses_of(changes: Sequence[MotorAlarm]) -> list[Fact]:
    """Returns the thrust that motors lost, the worst first: BAD while it lasts, WATCH with its end where it ended.

    Of what a motor lost until it recovered, the largest; it is BAD, too, where another still lacks less. Each has the
    ``names`` of all motors whose loss is BAD.
    """
    ended = []
    lasting = dict[tuple[int, str], MotorAlarm]()
    for change in changes:
        motor = change.boot, change.name
        if change.weak:
            largest = lasting.get(motor, change)
            lasting[motor] = max(largest, change, key=lambda loss: loss.size)
        elif motor in lasting:
            ended.append((lasting.pop(motor), change.since))
    least = min((loss.size for loss in lasting.values()), default=inf)
    losses = [loss.fact for loss in lasting.values()]
    for loss, until in ended:
        level = Level.BAD if loss.size > least else Level.WATCH
        losses.append(loss.fact.but(level, until=until))
    losses.sort(key=lambda loss: (loss.level is Level.WATCH, -loss.figures["rise"]))
    names = dict.fromkeys(loss.subject for loss in losses if loss.is_bad)
    return [loss.but(names=tuple(names)) for loss in losses]


def alarm_figures(changes: Sequence[MotorAlarm]) -> JsonValues:
    """Returns the keys of documents: alarms on motors, motors sound again, changes of steady torque, false alarms."""
    kinds = {
        "alarms": InFlight.MOTOR_LOST_THRUST,
        "recoveries": InFlight.MOTOR_RECOVERED,
        "torque_changes": InFlight.STEADY_TORQUE_CHANGED,
    }
    at_most = FALSE_ALARMS.figures["alarms_per_hour"]
    return {
        **{
            name: [change for change in changes if change.fact.code is code]
            for name, code in kinds.items()
        },
        "false_alarms_per_hour": {"at_most": at_most, "basis": FALSE_ALARMS},
    }


class MotorWatch:
    """The sequential test of one vehicle's motors, over the settled flights of one boot.

    How often it is wrong, ``FALSE_ALARMS`` says. Slower samples than ``MIN_RATE`` are not judged.

    Attributes:
        alarms: what was found so far.
        weak: the latest alarm on each motor, by place, that has not recovered; none after ``LONGEST_GAP``.
        latest: s, of the last sample.
        since: s, since when there is a reference; None without.
        obstacle: why nothing can be found, from settled flight of a few seconds on; None where it can.
    """

    def __init__(self, layout: MotorGeometry, boot: int = 0) -> None:
        """Begins, with the motors' ``layout``, in the vehicle's ``boot``, from 0 on."""
        self.alarms: list[MotorAlarm] = []
        self.weak: dict[int, MotorAlarm] = {}
        self._layout = layout
        self._boot = boot
        signatures = motor_signatures(layout)
        self._is_named = signatures.names_a_motor
        self.obstacle = None if self._is_named else Fact(InFlight.MOTOR_PLACES_UNKNOWN)
        self._weights = signatures.weights[1:]
        # (k, a) of a rise of each motor's own command by 1; of six and more motors the neighbours' rise too.
        self._own = np.diag(signatures.weak_motor_commands)
        self._signatures = self._weights.T / self._own[:, None]
        self._mixer = np.linalg.pinv(signatures.weights)
        # What loads change
        is_flat = [axis != "yaw" for axis in signatures.axes[1:]]
        self._flat = np.array(is_flat, dtype=np.float64)
        self._enough = log(HOURS_TO_FALSE_ALARM * 3600 / BLOCK_SECONDS)
        self.latest = -inf
        self.since: float | None = None

    def take(
        self, time: float, commands: Sequence[float] | Array, heading: float = 0.0
    ) -> list[MotorAlarm]:
        """Returns what a sample of the ``commands`` (k,), shares of the range, shows at ``time``, s, in settled flight.

        The ``heading``, rad, is NaN where the attitude does not follow its setpoint.
        """
        if not self._is_named:
            return []
        number = floor(time / BLOCK_SECONDS)
        step = time - self.latest
        if -LONGEST_GAP < step <= 0:
            return []  # doubled, or overtaken on its way: a mean of half a second does not need it
        if not 0 < step < LONGEST_GAP:
            self._times: list[float] = []
            self._blocks: list[Array] = []
            # NaN where the nose turns, or the attitude does not follow
            self._headings: list[float] = []
            self._steady_blocks = 0
            self._heading = heading
            self._noise = np.full(len(self._weights), PRIOR_SD**2)
            self._freedom = PRIOR_FREEDOM
            self.since = None
            self.weak.clear()
            # The block that is not whole yet
            self._number = number
            self._open = list[Any]()
            self._rate_from = time
            self._samples = 0
        self.latest = time
        passed = time - self._rate_from
        if passed >= REFERENCE_SECONDS:
            # A tenth less, for jitter
            is_slow = self._samples <= 0.9 * MIN_RATE * passed
            self.obstacle = TOO_SLOW if is_slow else None
            self._rate_from = time
            self._samples = 0
        self._samples += 1
        count = len(self.alarms)
        if number != self._number:
            if len(self._open) >= MIN_SAMPLES:
                end = (self._number + 1) * BLOCK_SECONDS
                commands_mean = np.mean(self._open, axis=0)
                self._block(end, commands_mean, heading)
            self._heading = heading
            self._number = number
            self._open = []
        self._open.append(commands)
        return self.alarms[count:]

    def _block(self, time: float, commands: Array, heading: float) -> None:
        mean = commands.mean()
        if not mean > 0:
            return
        self._times.append(time)
        self._blocks.append(self._weights @ (commands / mean))
        turned = _turn(heading, self._heading)
        is_steady = abs(turned) <= MAX_HEADING_CHANGE * BLOCK_SECONDS
        self._headings.append(heading if is_steady else nan)
        self._steady_blocks += is_steady
        self._keep(round(KEPT_SECONDS / BLOCK_SECONDS))
        expected = (self._times[-1] - self._times[0]) / BLOCK_SECONDS + 1
        if len(self._blocks) < PRESENT_SHARE * expected:
            return
        reference = NEXT_REFERENCE_SECONDS if self._freedom > PRIOR_FREEDOM else REFERENCE_SECONDS
        windows = np.array(
            [n for n in CHANGE_BLOCKS if len(self._blocks) >= n + reference / BLOCK_SECONDS], int
        )
        if len(windows):
            self.since = self.since or time
            self._weigh(windows)

    def _weigh(self, windows: Places) -> None:
        changes = _changes(np.array(self._blocks), windows, self._noise, self._freedom)
        null = _log_t(changes, 0.0)
        # No cause explains a change better than one of just this size: most are too small for any of them.
        log_scale = -np.log(changes.variance).sum(axis=-1) / 2
        best = log_scale - null
        # with all that recover, and three that are no motor's
        causes = len(self._signatures) + len(self.weak) + 4
        alternatives = ENDS_BESIDE_FAULTS * len(windows) + causes
        if best.max() + log(alternatives) < self._enough:
            return
        sound = np.eye(len(self._signatures))
        weak = [loss.size * sound[motor] for motor, loss in self.weak.items()]
        ends = [*weak, sum(weak)] if len(weak) > 1 else weak
        # (h, s, k) of the motors' commands, by cause and size: one motor weakens; a weak one recovers, and all do.
        rises = np.array(
            [np.outer(SIZES, motor) for motor in sound]
            + [np.outer(-RETURNS, motor) for motor in ends]
        )
        balances = rises @ self._signatures
        sized = balances.swapaxes(0, 1)[:, :, None]
        likelihoods = _log_t(changes, sized)
        by_window = _log_sum(likelihoods) - log(len(SIZES)) - null  # (h, w)
        kinds = self._flat, 1 - self._flat, np.ones_like(self._flat)
        load, *rest = (_log_t(changes, 0.0, OTHER_SD**2 * free) - null for free in kinds)
        motors = _log_sum(by_window.T) - log(len(sound))
        motors[len(sound) :] += log(ENDS_BESIDE_FAULTS)
        others = _log_sum([_log_sum(factors) for factors in rest])
        best = np.argmax(motors)
        other_motors = np.delete(motors, best)
        stranger = others + log(OTHERS_BESIDE_MOTORS)
        rivals = [*other_motors, _log_sum(load), stranger, 0.0]
        odds = motors[best] - _log_sum(rivals)
        if motors[best] >= self._enough and odds >= STRONG_EVIDENCE_NATS:
            window = int(np.argmax(by_window[best]))
            blocks_since = windows[window]
            if self._is_of_no_turn(blocks_since, changes, window):
                largest = rises[best, -1]
                self._motors_changed(largest, blocks_since, changes, window, odds)
            return
        seconds = windows * BLOCK_SECONDS
        lasting_load = load + np.where(seconds >= REFERENCE_SECONDS, 0.0, -inf)
        long = np.where(seconds >= STALE_SECONDS, 0.0, -inf)
        loaded = _log_sum(lasting_load)
        strange = long + _log_sum([*rest, load, *by_window])
        stranger = others + log(OTHERS_BESIDE_LOADS)
        odds = loaded - _log_sum([*motors, stranger, 0.0])
        if loaded >= self._enough and odds >= STRONG_EVIDENCE_NATS:
            window = int(np.argmax(lasting_load))
            blocks_since = windows[window]
            leant = changes.moved[window] * self._flat
            size = float(np.linalg.norm(leant))
            if self._is_of_no_turn(blocks_since, changes, window):
                self._found(None, blocks_since, odds, size)
        elif strange.max() >= self._enough:
            blocks_since = windows[np.argmax(strange)]
        else:
            return
        # What comes is compared with what is now.
        self._keep(blocks_since)

    def _keep(self, n: int) -> None:
        """Forgets all but the last ``n`` blocks."""
        drop = max(len(self._times) - n, 0)
        del self._times[:drop], self._blocks[:drop], self._headings[:drop]

    def _is_of_no_turn(self, n: int, changes: _Changes, window: int) -> bool:
        """Whether steady flight alone shows the change ``n`` blocks ago, and no turn of the nose explains it.

        Between two headings the wind's torque differs as between a sound and a weak motor: what changed must show at
        one heading before and after, or else at two headings after and at none before.
        """
        if self._steady_blocks * BLOCK_SECONDS < LEAST_SECONDS:
            return False
        blocks = np.array(self._blocks)
        weights = changes.moved[window] / changes.variance[window]
        now = blocks[-n:].mean(axis=0)
        whole = changes.moved[window] @ weights
        shown = (blocks - now) @ weights / whole
        turned = _turn(np.array(self._headings), self._headings[-1])
        sector_width = 2 * np.pi / SECTORS
        sectors = np.round(turned / sector_width) % SECTORS
        is_after = np.arange(len(blocks)) >= len(blocks) - n
        by_side = []
        for side in (~is_after, is_after):
            by_sector = {}
            for sector in range(SECTORS):
                rows = (sectors == sector) & side
                if np.count_nonzero(rows) >= SETTLING_BLOCKS:
                    by_sector[sector] = shown[rows].mean()
            by_side.append(by_sector)
        before, after = by_side
        common = before.keys() & after.keys()
        if common:
            return all(after[sector] - before[sector] > SHOWN_SHARE for sector in common)
        is_before = max(before.values(), default=0.0) < -SHOWN_SHARE
        return len(after) > 1 and is_before and min(after.values()) > -SHOWN_SHARE

    def _motors_changed(
        self, rises: Array, n: int, changes: _Changes, window: int, odds: float
    ) -> None:
        """What a change in proportion to ``rises`` (k,) says, which began ``n`` blocks ago."""
        since = np.mean(self._blocks[-n:], axis=0)
        before = since - changes.moved[window]
        after = np.mean(self._blocks[1 - n :], axis=0)  # Without the block that it began in
        # The balance is in shares of the mean command, which rises too.
        mean_rise = (rises / self._own).mean()
        signature = rises @ self._signatures - mean_rise * after
        weighted = signature / changes.variance[window]
        power = weighted @ signature
        commands = self._mixer @ [1.0, *before]
        own = rises / commands  # Of the motors' own commands
        rose = weighted @ (after - before) / power * own
        estimated = power**-0.5 * own
        settling = SETTLING_ERROR * rose
        error = coverage_factor() * np.hypot(estimated, settling)
        moved = np.flatnonzero(rises).tolist()
        for motor in moved:
            was = self.weak.pop(motor).size if motor in self.weak else 0.0
            low, size, high = (
                (1 + was) * (1 + rose[motor] + end * error[motor]) - 1 for end in (-1, 0, 1)
            )
            is_sound = size < max(SIZES[0], was / 4)
            if rises[motor] < 0 and (len(moved) > 1 or is_sound):
                self._found(motor, n, odds, 0.0)
                continue
            ends = zip((max(low, 0.0), high), THRUST_EXPONENTS, strict=True)
            loss = (min(lost_thrust(rise, power) / self._own[motor], 1.0) for rise, power in ends)
            rise = max(size, SIZES[0])
            self.weak[motor] = self._found(motor, n, odds, rise, *loss)
        # What comes is compared with what is now, once the vehicle has settled.
        self._keep(n - SETTLING_BLOCKS)
        self._noise = changes.noise[window]
        self._freedom = min(changes.freedom[window], MOST_FREEDOM)

    def _found(
        self, motor: int | None, n: int, odds: float, size: float, *loss: float
    ) -> MotorAlarm:
        layout = self._layout
        alarm = MotorAlarm(
            self._times[-1],
            self._times[-n] - BLOCK_SECONDS,
            None if motor is None else layout.motors[motor],
            "" if motor is None else layout.names[motor],
            size,
            1 / (1 + np.exp(-odds)),
            layout.positions_assumed,
            self._boot,
            loss,
        )
        self.alarms.append(alarm)
        return alarm
