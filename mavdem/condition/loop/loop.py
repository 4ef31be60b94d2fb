"""Loop: rate and attitude loop of one axis, whether they have enough margin, and gains that reach stated margins.

The gains hold in the worst case of the plant's posterior, and change one bounded step at a time. P, I and D of the rate
controller change by one factor, so that they keep their proportions: those of the autopilot's defaults or of whoever
tuned it. The gain of the attitude controller follows, with the rate loop of the new gains. Nothing is
sent to a vehicle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import NamedTuple

import numpy as np

from mavdem.condition.loop.controllers import Controller
from mavdem.condition.loop.margins import Margins, OpenLoop, loops_of, transfer
from mavdem.condition.loop.response import MeasuredResponse
from mavdem.dem.engine.linalg import Array
from mavdem.dem.graybox import Physical
from mavdem.dem.graybox.parameters import wind_density
from mavdem.dem.record import Record
from mavdem.facts import Fact, Level
from mavdem.facts.loops import Gains, Loops, Responses


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
FACTORS = [1.499 ** (step / 8) for step in range(8, -9, -1)]
"""Of a gain, at once, in even ratios up to 1.5 less what rounding it to four digits adds."""
SURE = 0.95  # share of the draws that must have all margins: the lower end of a 90 % interval
SATURATED = 0.05
"""Share of the samples with an input at a limit, from which on no linear loop describes the vehicle."""
# 1/s, that PX4 takes; ArduPilot recommends 12 for all
LARGEST_ANGLE = {"roll": 12.0, "pitch": 12.0, "yaw": 5.0}
# times the crossover, and Hz: what is faster in the gyro is noise, not motion
NOISE_FROM = 3.0, 10.0
OF_AXES = ("ATC_RAT_", "ATC_ANG_", "MC_ROLL", "MC_PITCH", "MC_YAW")
"""How parameters of one axis begin."""


@dataclass(frozen=True, eq=False, repr=False)
class Loop(Margins):
    """The loops of one ``axis``: ``rate`` and, with that closed, ``attitude``; it has the figures of ``rate``."""

    axis: str
    plant: Physical
    """Identified from the ``record``."""
    record: Record
    controller: Controller
    gains: Array
    """(N,) angular acceleration per demand, rad/s², of the estimate, and then of draws."""
    draws: Array
    """(N, 3) likewise of damping, 1/s, lag and delay, s, without the gyro's filter."""
    rate: OpenLoop
    attitude: OpenLoop
    cautions: tuple[Fact, ...]
    """What the figures do not allow for."""
    measured: MeasuredResponse | None = None
    """The response of the rate in flight, where the log has setpoints."""

    @property
    def figures(self) -> Mapping[str, Array]:
        """(N,) of each figure of the rate loop."""
        return self.rate.figures

    def __repr__(self) -> str:
        margins = f"phase_margin={self.phase_margin:.0f}, gain_margin={self.gain_margin:.1f}"
        return f"<Loop {self.axis}: crossover={self.crossover:.2f}, {margins}>"

    def changed(self, parameters: Mapping[str, float]) -> Loop:
        """Returns the loop with other values of some of the autopilot's ``parameters``, by name."""
        controller = self.controller.changed(parameters)
        rate, attitude = loops_of(controller, self.gains, self.draws)
        return replace(self, controller=controller, rate=rate, attitude=attitude, measured=None)

    @property
    def agrees(self) -> bool | None:
        """Whether the flight's response is the predicted one; None where too little of it was measured."""
        if self.measured is None:
            return None
        if (reason := self.measured.reason) is None:
            return True
        return None if reason.code is Responses.RESPONSE_UNEXPLAINED else False

    def sure_of(self, target: Target) -> float:
        """Returns the share of the draws in which both loops have the margins of ``target``."""
        return float(np.mean(_scores(target, self.rate, self.attitude) >= 1))

    @cached_property
    def advice(self) -> Advice:
        """Gains to set, with what to expect, or why there are none."""
        return advise(self)

    @property
    def lean_in_wind(self) -> float:
        """Standard deviation of the angle, degrees, in the wind of the flight about its mean, by this loop."""
        frequency = self.attitude.frequency
        power = np.abs(self.attitude.disturbance[0]) ** 2 * wind_density(self.plant, frequency)
        return float(np.degrees(np.sqrt(np.trapezoid(power, frequency))))


class Gain(NamedTuple):
    """A gain in the log, and to set."""

    now: float
    set: float


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
    """Gains to set, and what to expect of them."""

    target: Target
    """The margins asked for."""
    rating: Fact
    """Whether the loops of the flight have them."""
    refusals: tuple[Fact, ...]
    """Why there are no gains; none where there are."""
    before: Loop
    """By the gains of the log."""
    after: Loop
    """By the gains to set."""
    gains: dict[str, Gain]
    """By the autopilot's name; those that there are, changed or not."""
    sure: float
    """Share of the draws in which both loops have the margins."""
    noise: Noise | None
    """Of the gyro in the demand; None where the log is too slow to show it."""

    @property
    def parameters(self) -> dict[str, float]:
        """The gains to set, by the autopilot's name, where they change."""
        return {name: gain.set for name, gain in self.gains.items() if gain.set != gain.now}

    @property
    def sentence(self) -> Fact:
        """What to do, or why there is no advice."""
        if self.refusals:
            return Fact(Gains.NO_GAINS_ADVISED, reasons=self.refusals)
        code = Gains.STEP_TOWARDS_MARGINS
        if self.sure >= SURE:
            code = Gains.SET_GAINS if self.parameters else Gains.KEEP_GAINS
        return Fact(
            code,
            Level.GOOD if code is Gains.KEEP_GAINS else Level.WATCH,
            share=self.sure,
            has_room=self.rating.level is Level.GOOD,
            **self.target._asdict(),
        )


def advise(loop: Loop, tune: str = "default", doubts: Sequence[Fact] = ()) -> Advice:
    """Returns gains with which the ``loop`` has the margins of ``TARGETS[tune]``.

    The largest gains with which 95 % of the plant's draws have all margins, in both loops; where none within a factor
    of 1.5 has them, those that come closest. None where gains must not follow from this flight: for the ``doubts``
    about it, gains that change, motors at their limits, a loop that the flight contradicts, or that is unstable.
    """
    target = TARGETS[tune]
    refusals = tuple(doubts) or _refusals(loop)
    gains = {} if refusals else _best(loop, target)
    after = loop.changed(gains)
    return Advice(
        target=target,
        rating=margin_rating(loop, target),
        refusals=refusals,
        before=loop,
        after=after,
        gains={name: Gain(loop.controller.parameters[name], new) for name, new in gains.items()},
        sure=after.sure_of(target),
        noise=_noise(loop, after.controller),
    )


def _refusals(loop: Loop) -> tuple[Fact, ...]:
    """Why the loop itself gives no gains; the first reason."""
    limited = _limited_share(loop.controller, loop.record)
    if changed := changed_in(loop.record, loop.controller):
        return (Fact(Gains.GAINS_CHANGED, names=sorted(changed)),)
    if limited > SATURATED:
        return (Fact(Gains.MOTOR_AT_LIMIT, share=limited),)
    if not (loop.rate.stable[0] and loop.attitude.stable[0]):
        return (Fact(Gains.LOOP_UNSTABLE),)
    if loop.measured is not None and loop.measured.reason is not None and loop.agrees is False:
        return (loop.measured.reason,)
    return ()


def _best(loop: Loop, target: Target) -> dict[str, float]:
    """The gains to set, by name: of the rate loop, and then of the attitude loop about it."""
    names = loop.controller.names
    known = loop.controller.parameters
    chosen = dict[str, float]()
    factors = FACTORS
    for gains in (("p", "i", "d"), ("angle",)):
        scored = list[tuple[float, dict[str, float]]]()
        for factor in factors:
            stepped = {
                names[gain]: _stepped(loop, names[gain], factor)
                for gain in gains
                if known.get(names[gain])
            }
            changed = loop.changed(chosen | stepped)
            loops = (changed.rate,) if "p" in gains else (changed.rate, changed.attitude)
            scored.append((_worst(target, *loops), chosen | stepped))
            if scored[-1][0] >= 1:
                break
        score, chosen = max(scored, key=lambda pair: pair[0])
        if score < 1:  # on a rate loop without margin nothing is to be added
            factors = [factor for factor in FACTORS if factor <= 1]
    return chosen


def _stepped(loop: Loop, name: str, factor: float) -> float:
    """A gain times a factor; that of the angle not beyond what autopilots take."""
    now = loop.controller.parameters[name]
    most = np.inf
    if name == loop.controller.names["angle"]:
        most = max(now, LARGEST_ANGLE[loop.axis])
    return now if factor == 1 else min(float(f"{factor * now:.4g}"), most)


def margin_rating(loop: Loop, target: Target = TARGETS["default"]) -> Fact:
    """Returns whether rate and attitude ``loop`` have the margins of ``target``: good, perhaps (watch), or bad.

    Its figures are those of the weaker loop.
    """
    loops = {"rate": loop.rate, "attitude": loop.attitude}
    name, weak = min(loops.items(), key=lambda item: _worst(target, item[1]))
    level = Level.BAD
    if _worst(target, *loops.values()) >= 1:
        level = Level.GOOD
    elif _scores(target, *loops.values())[0] >= 1:
        level = Level.WATCH
    return Fact(
        Loops.MARGIN_RATING,
        level,
        subject=name,
        phase_margin=weak.phase_margin,
        phase_margin_interval=weak.phase_margin_interval,
        gain_margin=weak.gain_margin if isfinite(weak.gain_margin) else None,
        ms=weak.ms,
    )


def _scores(target: Target, *loops: OpenLoop) -> Array:
    """(N,) the least of the margins over that of the target: 1 and more has them all, unstable is below 0."""
    scores = []
    for loop in loops:
        phase = loop.figures["phase_margin"] / target.phase_margin
        gain = loop.figures["gain_margin"] / target.gain_margin
        least = np.min([phase, gain, target.ms / loop.figures["ms"]], axis=0)
        scores.append(np.where(loop.stable, least, -np.inf))
    return np.asarray(np.min(scores, axis=0))


def _worst(target: Target, *loops: OpenLoop) -> float:
    """The score that 95 % of the draws have at least."""
    return float(np.quantile(_scores(target, *loops), 1 - SURE, method="lower"))


def changed_in(record: Record, controller: Controller) -> dict[str, float]:
    """Returns the parameters of a ``controller`` that changed in the ``record``, with their values before."""
    prefix = controller.names["p"][:-1]
    return {
        name: old
        for name, old in record.earlier.items()
        if name in controller.names.values()
        or name.startswith(prefix)
        or not name.startswith(OF_AXES)
    }


def _limited_share(controller: Controller, record: Record) -> float:
    """Of the samples with an input within 0.5 % of a limit, where the range of the inputs is known."""
    if len(record.input_range) != 2:
        return 0.0
    low, high = record.input_range
    share = (record.inputs - low) / (high - low)
    begin, end = (0.0, 1.0) if record.inputs.shape[1] == 1 else controller.spin
    return float(np.mean(np.any((share <= begin + 0.005) | (share >= end - 0.005), axis=1)))


def _noise(loop: Loop, after: Controller) -> Noise | None:
    """The rate's spectrum above the motion, as logged behind the gyro's filter, through the controllers."""
    from scipy.signal import welch  # it takes half a second to import

    record = loop.record
    times, least = NOISE_FROM
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
    before, without_d, then = (
        transfer(one, frequency)[1] for one in (now, replace(now, d=0.0), after)
    )
    size, by_d, new = (
        float(np.sqrt(step * np.sum(np.abs(response) ** 2 * density)))
        for response in (before, before - without_d, then)
    )
    return Noise(lowest, highest, size, new, by_d, (new / size) ** 2)
