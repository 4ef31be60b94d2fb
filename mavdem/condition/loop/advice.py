"""Advice: gains that reach stated margins in the worst case of the plant's posterior, one bounded step at a time.

P, I and D of the rate controller change by one factor, so that they keep their proportions: those of the autopilot's
defaults or of whoever tuned it. The gain of the attitude controller follows, with the rate loop of the new gains.
Nothing is sent to a vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from mavdem.condition.loop.loop import Loop, changed_in
from mavdem.condition.loop.response import transfer
from mavdem.dem.engine.linalg import Array
from mavdem.dem.record import Record
from mavdem.facts import Fact, Level
from mavdem.facts.loops import Loops
from mavdem.ingest.controllers import Controller


class Target(NamedTuple):
    """Margins that a loop is to have: degrees and dB at least, and the largest sensitivity at most."""

    phase_margin: float
    gain_margin: float
    ms: float


TARGETS = {
    "soft": Target(55.0, 8.0, 1.7),
    "default": Target(45.0, 6.0, 2.0),
    "sharp": Target(40.0, 5.0, 2.3),
}
"""Phase of 45°, gain of 6 dB and Ms of 2 are the usual ones (K. J. Åström and R. M. Murray, Feedback Systems, 2nd ed.,
sec. 10.3)."""
LARGEST_STEP = 1.499
STEPS = 8
DIGITS = 4
"""Of a gain, at once: 1.5 less what rounding it to so many digits adds; and in how many even ratios up to it."""
SURE = 0.95  # share of the draws that must have all margins: the lower end of a 90 % interval
SATURATED = 0.05
AT_LIMIT = 0.005
"""Share of the samples with an input at a limit, from which on no linear loop describes the vehicle; and of the range,
how near to its end that is."""
# 1/s, that PX4 takes; ArduPilot recommends 12 for all
LARGEST_ANGLE = {"roll": 12.0, "pitch": 12.0, "yaw": 5.0}
# times the crossover, and Hz: what is faster in the gyro is noise, not motion
NOISE_FROM = 3.0, 10.0
LOOPS = ("rate", "attitude")
NOT_CHECKED = (
    "bending of the frame, notch filters against it, and another battery voltage, load or propeller: the margins are "
    "those of this flight."
)


class Noise(NamedTuple):
    """What noise of the gyro makes of the demand, standard deviations of the demand, 1 being all the mixer takes."""

    lowest: float  # Hz, from which on
    highest: float  # up to which the log shows the gyro
    before: float
    after: float
    by_d: float  # of the term D alone, before
    heat: float  # how many times that of fast commands in the motors: it grows with their square


@dataclass(frozen=True, eq=False, repr=False)
class Advice:
    """Gains to set, and what to expect of them.

    Attributes:
        target: the margins asked for.
        rating: whether the loops of the flight have them.
        refusal: why there are no gains, one sentence; empty where there are.
        before, after: the loops by the gains of the log, and by the gains to set.
        gains: (now, to set) by the autopilot's name; those that there are, changed or not.
        sure: share of the draws in which both loops have the margins.
        noise: of the gyro in the demand; None where the log is too slow to show it.
    """

    target: Target
    rating: Fact
    refusal: str
    before: Loop
    after: Loop
    gains: dict[str, tuple[float, float]]
    sure: float
    noise: Noise | None

    @property
    def parameters(self) -> dict[str, float]:
        """The gains to set, by the autopilot's name, where they change."""
        return {name: new for name, (old, new) in self.gains.items() if new != old}

    @property
    def sentence(self) -> str:
        """What to do, in a sentence or two, or why there is no advice."""
        phase, gain, ms = self.target
        margins = (
            f"at least {phase:g}° of phase and {gain:g} dB of gain margin, and Ms of at most {ms:g}"
        )
        share = f"in {100 * self.sure:.0f} % of the plants that fit the flight"
        if self.refusal:
            return f"No gains are advised. {self.refusal}"
        if self.sure >= SURE and not self.parameters:
            return f"Keep the gains: both loops have {margins} {share}, and would not with larger ones."
        if self.sure >= SURE:
            enough = self.rating.level is Level.GOOD
            set_them = (
                "There is room for these gains: both loops then still"
                if enough
                else "Set these gains: both loops then"
            )
            return f"{set_them} have {margins}, {share}."
        return f"These gains are a step towards {margins}, reached {share}: fly them with care, and tune again."

    def as_dict(self) -> dict[str, Any]:
        """Returns plain JSON values."""
        known = {
            "loop": self.before.as_dict(),
            "target": self.target._asdict(),
            "verdict": str(self.rating),
        }
        gains = {name: {"now": old, "set": new} for name, (old, new) in self.gains.items()}
        noise = self.noise and self.noise._asdict()
        expected = None if self.refusal else self.after.as_dict()
        return {
            **known,
            "sentence": self.sentence,
            "sure": self.sure,
            "gains": gains,
            "expected": expected,
            "noise": noise,
        }


def advise(loop: Loop, tune: str = "default", doubts: Sequence[str] = ()) -> Advice:
    """Returns gains with which the ``loop`` has the margins of ``TARGETS[tune]``.

    The largest gains with which 95 % of the plant's draws have all margins, in both loops; where none within a factor
    of 1.5 has them, those that come closest. None where gains must not follow from this flight: for the ``doubts``
    about it, gains that change, motors at their limits, a loop that the flight contradicts, or that is unstable.
    """
    target = TARGETS[tune]
    names = loop.controller.names
    known = loop.controller.parameters
    factors = [LARGEST_STEP ** (step / STEPS) for step in range(STEPS, -STEPS - 1, -1)]

    def best(
        others: dict[str, float], gains: Sequence[str], loops: Sequence[str]
    ) -> dict[str, float]:
        present = {names[gain]: known[names[gain]] for gain in gains if known.get(names[gain])}
        candidates = [
            others | {name: _stepped(loop, name, by) for name in present} for by in factors
        ]
        scored = list[tuple[float, dict[str, float]]]()
        for one in candidates:
            scored.append((_worst(loop.changed(one), target, loops), one))
            if scored[-1][0] >= 1:
                return one
        return max(scored, key=lambda pair: pair[0])[1]

    limited = _limited_share(loop.controller, loop.record)
    refusal = " ".join(doubts)
    gains = dict[str, float]()
    if not refusal and (changed := sorted(changed_in(loop.record, loop.controller))):
        refusal = (
            f"{', '.join(changed)} changed in this log: fly with one set of gains, and tune again."
        )
    if not refusal and limited > SATURATED:
        refusal = f"A motor is at a limit {100 * limited:.0f} % of the time: no linear loop describes that."
    if not refusal and not (loop.rate.stable[0] and loop.attitude.stable[0]):
        refusal = "The identified loop is unstable, and yet it flew: the plant or the controller is wrong."
    if not refusal and loop.measured is not None and loop.agrees is False:
        refusal = loop.measured.reason
    if not refusal:
        gains = best({}, ("p", "i", "d"), ["rate"])
        if _worst(loop.changed(gains), target, ["rate"]) < 1:
            # on a rate loop without margin nothing is to be added
            factors = [by for by in factors if by <= 1]
        gains = best(gains, ["angle"], LOOPS)
    after = loop.changed(gains)
    return Advice(
        target=target,
        rating=margin_rating(loop, target),
        refusal=refusal,
        before=loop,
        after=after,
        gains={name: (known[name], new) for name, new in gains.items()},
        sure=float(np.mean(_scores(after, target) >= 1)),
        noise=_noise(loop, after.controller),
    )


def _stepped(loop: Loop, name: str, factor: float) -> float:
    """A gain times a factor; that of the angle not beyond what autopilots take."""
    now = loop.controller.parameters[name]
    controller = loop.controller
    most = max(now, LARGEST_ANGLE[loop.axis]) if name == controller.names["angle"] else np.inf
    return now if factor == 1 else min(float(f"{factor * now:.{DIGITS}g}"), most)


def margin_rating(loop: Loop, target: Target = TARGETS["default"]) -> Fact:
    """Returns whether rate and attitude ``loop`` have the margins of ``target``: good, perhaps (watch), or bad.

    Its figures are those of the weaker loop.
    """
    which = min(LOOPS, key=lambda one: _worst(loop, target, [one]))
    weak = getattr(loop, which)
    level = Level.BAD
    if _worst(loop, target) >= 1:
        level = Level.GOOD
    elif _scores(loop, target)[0] >= 1:
        level = Level.WATCH
    return Fact(
        Loops.MARGIN_RATING,
        level,
        subject=f"{which} loop",
        phase_margin=weak.phase_margin,
        phase_margin_interval=weak.phase_margin_interval,
        gain_margin=weak.gain_margin if isfinite(weak.gain_margin) else None,
        ms=weak.ms,
    )


def _scores(loop: Loop, target: Target, loops: Sequence[str] = LOOPS) -> Array:
    """(N,) the least of the margins over that of the target: 1 and more has them all, unstable is below 0."""
    scores = []
    for one in (getattr(loop, which) for which in loops):
        phase, gain, ms = (one.figures[name] for name in target._fields)
        shares = phase / target.phase_margin, gain / target.gain_margin, target.ms / ms
        scores.append(np.where(one.stable, np.min(shares, axis=0), -np.inf))
    return np.asarray(np.min(scores, axis=0))


def _worst(loop: Loop, target: Target, loops: Sequence[str] = LOOPS) -> float:
    """The score that 95 % of the draws have at least."""
    return float(np.quantile(_scores(loop, target, loops), 1 - SURE, method="lower"))


def _limited_share(controller: Controller, record: Record) -> float:
    """Of the samples with an input at a limit, where the range of the inputs is known."""
    if len(record.input_range) != 2:
        return 0.0
    low, high = record.input_range
    share = (record.inputs - low) / (high - low)
    begin, end = (0.0, 1.0) if record.inputs.shape[1] == 1 else controller.spin
    return float(np.mean(np.any((share <= begin + AT_LIMIT) | (share >= end - AT_LIMIT), axis=1)))


def _noise(loop: Loop, after: Controller) -> Noise | None:
    """The rate's spectrum above the motion, as logged behind the gyro's filter, through the controllers."""
    from scipy.signal import welch  # it takes half a second to import

    record = loop.record
    (times, least) = NOISE_FROM
    highest = 0.45 / record.dt
    lowest = max(times * loop.rate.crossover, least)
    if not 2 * lowest < highest:
        return None
    frequency, density = welch(record.outputs[:, -1], 1 / record.dt, nperseg=min(256, len(record)))
    kept = (frequency >= lowest) & (frequency <= highest)
    frequency = frequency[kept]
    density = density[kept]
    step = float(frequency[1] - frequency[0])
    now = loop.controller

    def size(response: Any) -> float:
        return float(np.sqrt(step * np.sum(np.abs(response) ** 2 * density)))

    before, without_d, then = (
        transfer(one, frequency)[1] for one in (now, replace(now, d=0.0), after)
    )
    heat = (size(then) / size(before)) ** 2
    return Noise(lowest, highest, size(before), size(then), size(before - without_d), heat)
