"""Advice: gains of one axis with which wind moves the vehicle least, among those that keep stated margins.

P, I and D of the rate controller and the gain of the attitude controller are each free, by a bounded step at once. The
margins hold in draws of the plant's posterior with more and less control effectiveness than in the flight, as by a
full and an empty battery, or load. Half of the draws choose the gains, the others judge them. Nothing is sent to a
vehicle.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import CONFIDENCE_LEVEL, INTERVAL_QUANTILES
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import Gains, Loops
from mavdem.immutable import ImmutableResult
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.axis_loops import (
    MARGIN_TARGETS,
    Loop,
    MarginTarget,
    margin_rating,
    margin_scores,
    parameters_changed_in_flight,
)
from mavdem.loops.controllers import Controller, controller_from_parameters
from mavdem.loops.limit_cycles import MIN_AT_LIMIT_SHARE, Oscillation
from mavdem.loops.margins import FrequencyGrid, controller_response

GAINS = "p", "i", "d", "angle_gain"
MAX_GAIN_STEP = 3.0
"""Times, that a gain grows or falls at most at once: with 2, wind leans simulated vehicles a tenth more."""
EFFECTS = 1.0, 0.8, 1.2
"""Of the flight's control effectiveness: a full battery raises it by up to a fifth, an empty one or load lowers it."""
LOUDER = 1.25
SLOWER = 0.9
"""Times the noise in the demand, at most, and times the bandwidth of both loops, at least; margins come first."""
CHOOSING = 20  # draws that the gains are searched by
COARSE = FrequencyGrid(0.05, 100.0, 60)
SHORT = 0.035  # share of the draws that may lack the margins, for 0.05 of the others to lack them
PRICES = np.array([30.0, 30.0, 1.0, 1.0])
"""Of a share that margins, noise and the two bandwidths are beyond their limits, by the logarithm of the lean."""
PASSES = (0.4, 80), (-0.4, 80), (0.3, 80), (-0.1, 60)
"""First steps of each search, as logarithms of gains, and how many gains it tries."""
LOWERED = 2 / 3  # times the gains by which a vehicle oscillates: 3.5 dB
# 1/s, that PX4 takes; ArduPilot recommends 12 for all
MAX_ANGLE_GAIN = {"roll": 12.0, "pitch": 12.0, "yaw": 5.0}
# times the crossover, and Hz: what is faster in the gyro is noise, not motion
NOISE_FROM = 3.0, 10.0


class Gain(NamedTuple):
    """A gain in the log, and to set."""

    now: float
    set: float


class DemandNoise(NamedTuple):
    """What noise of the gyro makes of the demand, standard deviations of the demand, 1 being all the mixer takes."""

    lowest: float  # Hz, from which on
    highest: float  # up to which the log shows the gyro
    before: float
    after: float
    by_d: float  # of the term D alone, before
    heat: float  # how many times that of fast commands in the motors: it grows with their square


@dataclass(frozen=True, eq=False, repr=False)
class Advice(ImmutableResult):
    """Gains to set, and what to expect of them."""

    target: MarginTarget
    """The margins asked for."""
    rating: Fact
    """Whether the loops of the flight have them."""
    refusals: Facts
    """Why there are no gains; none where there are."""
    before: Loop
    """By the gains of the log."""
    after: Loop
    """By the gains to set, of draws that did not choose them."""
    gains: dict[str, Gain]
    """By the autopilot's name; those that there are, changed or not."""
    sure: float
    """Share of the draws, each with all ``EFFECTS``, in which both loops have the margins."""
    noise: DemandNoise | None
    """Of the gyro in the demand; None where the log is too slow to show it."""

    @property
    def parameters(self) -> Parameters:
        """The gains to set, by the autopilot's name, where they change."""
        return {name: gain.set for name, gain in self.gains.items() if gain.set != gain.now}

    @property
    def sentence(self) -> Fact:
        """What to do, or why there is no advice."""
        if self.refusals:
            return Fact(Gains.NO_GAINS_ADVISED, reasons=self.refusals)
        code = Gains.STEP_TOWARDS_MARGINS
        if not self.parameters:
            code = Gains.KEEP_GAINS
        elif self.sure >= INTERVAL_QUANTILES[1]:
            code = Gains.SET_GAINS
        return Fact(
            code,
            share=self.sure,
            has_room=self.rating.is_good,
            **self.target._asdict(),
        )


def advise(
    loop: Loop, tune: str = "default", doubts: Sequence[Fact] = (), *, more: bool = False
) -> Advice:
    """Returns gains with which the ``loop`` has the margins of ``MARGIN_TARGETS[tune]`` and wind moves it least.

    A loop that has these margins, surely or perhaps, keeps its gains unless ``more`` is asked: so do gains that were
    advised and then flown. None where gains must not follow from this flight: for the ``doubts`` about it, gains that
    change, motors at their limits, a loop that the flight contradicts, or that is unstable; nor where wind makes
    the effectiveness seem low, by more than ``EFFECTS`` allow, unless the loop surely lacks the least margins: it must
    not fly the movements that show more.
    """
    target = MARGIN_TARGETS[tune]
    rating = margin_rating(loop, target)
    changes = more or rating.is_bad
    refusals = tuple(doubts) or _refusals(loop, changes)
    chosen = {} if refusals else dict(_gains_of(loop))
    if chosen and changes:
        chosen |= _best(loop, target)
    after = loop.with_draws(slice(len(loop.effectiveness) // 2, None)).with_parameters(chosen)
    return Advice(
        target=target,
        rating=rating,
        refusals=refusals,
        before=loop,
        after=after,
        gains={name: Gain(loop.controller.parameters[name], new) for name, new in chosen.items()},
        sure=after.with_draws(slice(1, None), EFFECTS).share_meeting(target),
        noise=_noise(loop, after.controller),
    )


def _best(loop: Loop, target: MarginTarget) -> Parameters:
    """The gains to set, by name: of the least lean in wind, or else those that come closest to the margins.

    Their cost is the logarithm of the lean and, of each limit that is crossed, how far: an exact penalty.
    """
    from scipy.optimize import minimize  # it takes half a second to import

    gains = _gains_of(loop)
    largest = {loop.controller.parameter_names["angle_gain"]: MAX_ANGLE_GAIN[loop.axis]}
    most = [max(value, largest.get(name, np.inf)) for name, value in gains.items()]
    half = len(loop.effectiveness) // 2
    many = loop.with_draws(slice(1, half), EFFECTS, COARSE)
    few = loop.with_draws(slice(1, half, -(-half // CHOOSING)), EFFECTS, COARSE)
    frequency, shown = _gyro(loop)
    density = np.ones(len(frequency)) if shown is None else shown
    loudest = LOUDER * _demand(loop.controller, frequency, density)
    slowest = [SLOWER * margins_now.bandwidth for margins_now in (few.rate, few.attitude)]

    def stepped(steps: Array) -> Parameters:
        factors = np.exp(steps).clip(1 / MAX_GAIN_STEP, MAX_GAIN_STEP)
        new = np.minimum(factors * list(gains.values()), most)
        return {name: float(f"{value:.4g}") for name, value in zip(gains, new, strict=True)}

    def margins(now: Loop) -> float:
        scores = margin_scores(target, now.rate, now.attitude)
        return np.quantile(scores.clip(-1.0), SHORT)

    def cost(steps: Array, aim: float) -> float:
        now = few.with_parameters(stepped(steps))
        noise = _demand(now.controller, frequency, density) / loudest
        faster = np.array([now.rate.bandwidth, now.attitude.bandwidth]) / slowest
        too_slow = 1 - np.nan_to_num(faster, nan=1.0)
        crossed = [1 - margins(now) / aim, noise - 1, *too_slow]
        return np.log(now.angle_deviation(few.wind)) + np.maximum(crossed, 0.0) @ PRICES

    # there are several minima: less I, or more of it with less P
    begun = map(np.array, product((-1.0, -0.4, 0.6), repeat=len(gains)))
    steps = min(begun, key=lambda trial: cost(trial, 1.0))
    aim = 1.0
    for size, tries in PASSES:
        simplex = np.vstack([steps, steps + size * np.eye(len(gains))])
        steps = minimize(
            cost,
            steps,
            (aim,),
            "Nelder-Mead",
            options={"maxfev": tries, "initial_simplex": simplex},
        ).x
        new = stepped(steps)
        if margins(few.with_parameters(new)) >= 0.99 * aim:
            aim *= 1.005 / min(margins(many.with_parameters(new)), 1.005)
    return new


def _gains_of(loop: Loop) -> Parameters:
    """The gains that there are, by name; a gain of 0 stays so."""
    names = (loop.controller.parameter_names[gain] for gain in GAINS)
    parameters = loop.controller.parameters
    return {name: parameters[name] for name in names if parameters.get(name)}


def gain_reduction_advice(oscillation: Oscillation, parameters: Parameters) -> Fact:
    """Returns which gains to lower by a third, of a vehicle that oscillates by the controller of these ``parameters``.

    They are P and D of the rate or, where it oscillates so slowly that these do little, the gain of the angle or I. No
    values where the parameters have no controller.
    """
    changes = []
    for cycle in (oscillation, *oscillation.other_axes):
        with suppress(NotLearnable):
            controller = controller_from_parameters(parameters, cycle.axis, (1.0,))
            turning = 2 * np.pi * (cycle.frequency or np.inf)
            corners = {"angle_gain": controller.angle_gain, "i": controller.i / controller.p}
            slow = [gain for gain, corner in corners.items() if corner > turning / 2]
            names = [controller.parameter_names[gain] for gain in slow or ("p", "d")]
            values = [(name, parameters[name]) for name in names]
            changes += [(name, value, LOWERED * value) for name, value in values if value]
    return Fact(Gains.LOWER_GAINS, changes=changes, **oscillation.figures)


def _refusals(loop: Loop, changes: bool) -> Facts:
    """Why the loop itself gives no gains, or none that are ``changes``; the first reason."""
    record = loop.record
    if changed := parameters_changed_in_flight(record, loop.controller):
        return (Fact(Gains.GAINS_CHANGED, names=sorted(changed)),)
    limited = 0.0
    if len(record.input_range) == 2:
        low, high = record.input_range
        # within 0.5 % of a limit
        limited = loop.controller.outputs_at_limit((record.inputs - low) / (high - low)).mean()
    if limited > MIN_AT_LIMIT_SHARE:
        return (Fact(Gains.MOTOR_AT_LIMIT, share=limited),)
    if not (loop.rate.stable[0] and loop.attitude.stable[0]):
        return (Fact(Gains.LOOP_UNSTABLE),)
    if loop.disagreement:
        return (loop.disagreement,)
    if (
        not changes
        or loop.plant.bias >= 0
        or loop.share_meeting(MARGIN_TARGETS["sharp"]) <= 1 - CONFIDENCE_LEVEL
    ):
        return ()
    return tuple(doubt for doubt in loop.cautions if doubt.code is Loops.EFFECT_BIASED)


def _noise(loop: Loop, after: Controller) -> DemandNoise | None:
    """Of the gyro, by the controllers of the ``loop`` and ``after``; None where the log does not show it."""
    frequency, density = _gyro(loop)
    if density is None:
        return None
    now = loop.controller
    size, new = (_demand(chain, frequency, density) for chain in (now, after))
    by_d = _demand(now, frequency, density, replace(now, d=0.0))
    return DemandNoise(frequency[0], frequency[-1], size, new, by_d, (new / size) ** 2)


def _gyro(loop: Loop) -> tuple[Array, Array | None]:
    """(F,) Hz above the motion, and the rate's spectrum there as logged behind the gyro's filter, where it shows."""
    from scipy.signal import welch  # it takes half a second to import

    record = loop.record
    times, least = NOISE_FROM
    highest = 0.45 / record.dt
    lowest = max(times * loop.rate.crossover, least)
    if not 2 * lowest < highest:
        return np.linspace(lowest, 0.45 / loop.controller.loop_period), None
    rate = record.outputs[:, -1]
    frequency, density = welch(rate, 1 / record.dt, nperseg=min(256, len(record)))
    kept = (frequency >= lowest) & (frequency <= highest)
    return frequency[kept], density[kept]


def _demand(
    controller: Controller, frequency: Array, density: Array, without: Controller | None = None
) -> float:
    """Standard deviation of the demand by noise of this ``density``; less what goes through another controller."""
    _, response = controller_response(controller, frequency)
    if without is not None:
        response = response - controller_response(without, frequency)[1]
    power = np.abs(response) ** 2 * density
    return float(np.sqrt(np.trapezoid(power, frequency)))
