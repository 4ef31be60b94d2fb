"""Loop: rate and attitude loop of one axis, whether they have enough margin, and the same loop by other gains.

Margins are of the estimated plant and of draws from its posterior; ``advice`` looks for gains that keep them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import INTERVAL_QUANTILES
from mavdem.dem.record import Record
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.loops import Loops, Responses
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.controllers import Controller
from mavdem.loops.margins import GRID, Margins, OpenLoop, attitude_loop, rate_loop
from mavdem.loops.measured_response import MeasuredResponse
from mavdem.plant import Physical
from mavdem.plant.parameters import wind_torque_density

if TYPE_CHECKING:
    from mavdem.loops.advice import Advice


class MarginTarget(NamedTuple):
    """Margins that a loop is to have: degrees and dB at least, and the maximum sensitivity at most."""

    phase_margin: float
    gain_margin: float
    ms: float


MARGIN_TARGETS = {
    "soft": MarginTarget(55.0, 8.0, 1.7),
    "default": MarginTarget(45.0, 6.0, 2.0),
    "sharp": MarginTarget(40.0, 5.0, 2.3),
}
"""Phase of 45°, gain of 6 dB and Ms of 2 are the usual ones (K. J. Åström and R. M. Murray, Feedback Systems, 2nd ed.,
sec. 10.3)."""
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
    effectiveness: Array
    """(N,) angular acceleration per demand, rad/s², of the estimate, and then of draws."""
    dynamics: Array
    """(N, 3) likewise of damping, 1/s, lag and delay, s, without the gyro's filter."""
    cautions: Facts = ()
    """What the figures do not allow for."""
    measured: MeasuredResponse | None = None
    """The response of the rate in flight, where the log has setpoints."""
    grid: tuple[float, float, int] = GRID
    """Of the frequencies, as ``GRID``."""
    refusal: ClassVar[None] = None
    """Why the loops are not known: they are."""

    @property
    def advice(self) -> Advice:
        """Gains to set, with what to expect, or why there are none; :func:`mavdem.loops.advice.advise`."""
        from mavdem.loops.advice import advise

        return advise(self)

    @cached_property
    def rate(self) -> OpenLoop:
        """The loop of the rate."""
        return rate_loop(self.controller, self.effectiveness, self.dynamics, self.grid)

    @cached_property
    def attitude(self) -> OpenLoop:
        """The loop of the attitude, with that of the rate closed."""
        return attitude_loop(self.controller, self.rate)

    @property
    def figures(self) -> Mapping[str, Array]:
        """(N,) of each figure of the rate loop."""
        return self.rate.figures

    def __repr__(self) -> str:
        margins = f"phase_margin={self.phase_margin:.0f}, gain_margin={self.gain_margin:.1f}"
        return f"<Loop {self.axis}: crossover={self.crossover:.2f}, {margins}>"

    def with_parameters(self, parameters: Parameters) -> Loop:
        """Returns the loop with other values of some of the autopilot's ``parameters``, by name."""
        return replace(self, controller=self.controller.with_parameters(parameters), measured=None)

    def drawn(
        self,
        rows: slice,
        effects: Sequence[float] = (1.0,),
        grid: tuple[float, float, int] = GRID,
    ) -> Loop:
        """Returns the loop of the estimate and these ``rows`` of all, each with ``effects`` times its gain."""
        kept = np.append(0, np.arange(len(self.effectiveness))[rows])
        gains = np.outer(effects, self.effectiveness[kept]).ravel()
        draws = np.tile(self.dynamics[kept], (len(effects), 1))
        return replace(self, effectiveness=gains, dynamics=draws, grid=grid)

    @property
    def agrees(self) -> bool | None:
        """Whether the flight's response is the predicted one; None where too little of it was measured."""
        reason = None if self.measured is None else self.measured.reason
        if self.measured is None or (reason and reason.code is Responses.RESPONSE_UNEXPLAINED):
            return None
        return reason is None

    @property
    def disagreement(self) -> Fact | None:
        """Why the flight's response is not the predicted one; None where it is, or where too little was measured."""
        return self.measured.reason if self.measured and self.agrees is False else None

    def share_meeting(self, target: MarginTarget) -> float:
        """Returns the share of the draws in which both loops have the margins of ``target``."""
        return float(np.mean(margin_scores(target, self.rate, self.attitude) >= 1))

    @cached_property
    def wind(self) -> Array:
        """(F,) the spectral density of the flight's wind torque at the loop's frequencies, (rad/s²)²/Hz."""
        return wind_torque_density(self.plant, self.rate.frequency)

    @property
    def lean_in_wind(self) -> float:
        """Standard deviation of the angle, degrees, in the wind of the flight about its mean, by this loop."""
        return self.lean_in(self.wind)

    def lean_in(self, wind: Array) -> float:
        """Returns the same in another ``wind``, whose torque has this density (F,)."""
        power = np.abs(self.attitude.disturbance[0]) ** 2 * wind
        return float(np.degrees(np.sqrt(np.trapezoid(power, self.rate.frequency))))


LoopsByAxis = dict[str, Loop]


def identified_loops(loops: Mapping[str, object]) -> LoopsByAxis:
    """Returns the ``loops`` without the axes of which there is only why they are not known."""
    return {axis: loop for axis, loop in loops.items() if isinstance(loop, Loop)}


def margin_rating(loop: Loop, target: MarginTarget = MARGIN_TARGETS["default"]) -> Fact:
    """Returns whether rate and attitude ``loop`` have the margins of ``target``: good, perhaps (watch), or bad.

    Its figures are those of the weaker loop: which margin is ``lacking`` most, and what ``share`` of it there is.
    """
    loops = {"rate": loop.rate, "attitude": loop.attitude}
    name, weak = min(loops.items(), key=lambda item: margin_scores(target, item[1])[0])
    scores = margin_scores(target, *loops.values())
    level = Level.BAD
    if np.quantile(scores, 1 - INTERVAL_QUANTILES[1], method="lower") >= 1:
        level = Level.GOOD
    elif scores[0] >= 1:
        level = Level.WATCH
    shares = margin_ratios(target, weak)
    return Fact(
        Loops.MARGIN_RATING,
        level,
        subject=name,
        lacking=min(shares, key=lambda figure: shares[figure][0]),
        share=max(scores[0], -1.0),
        phase_margin=weak.phase_margin,
        phase_margin_interval=weak.phase_margin_interval,
        gain_margin=weak.gain_margin if isfinite(weak.gain_margin) else None,
        gain_margin_interval=np.minimum(weak.gain_margin_interval, 99.0),
        ms=weak.ms,
        ms_interval=weak.ms_interval,
    )


def margin_scores(target: MarginTarget, *loops: OpenLoop) -> Array:
    """Returns (N,) the least of the margins over that of the target: 1 and more has them all, unstable is below 0."""
    least = [
        np.where(loop.stable, np.min([*margin_ratios(target, loop).values()], axis=0), -np.inf)
        for loop in loops
    ]
    return np.min(least, axis=0)


def margin_ratios(target: MarginTarget, loop: OpenLoop) -> dict[str, Array]:
    """Returns (N,) of the margins by name, each over that of the target."""
    return {
        "phase_margin": loop.figures["phase_margin"] / target.phase_margin,
        "gain_margin": loop.figures["gain_margin"] / target.gain_margin,
        "ms": target.ms / loop.figures["ms"],
    }


def parameters_changed_in_flight(record: Record, controller: Controller) -> Parameters:
    """Returns the parameters of a ``controller`` that changed in the ``record``, with their values before."""
    prefix = controller.names["p"][:-1]
    return {
        name: old
        for name, old in record.earlier.items()
        if name in controller.names.values()
        or name.startswith(prefix)
        or not name.startswith(OF_AXES)
    }
