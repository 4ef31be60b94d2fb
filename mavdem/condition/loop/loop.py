"""The loops of one axis: the identified plant, with its posterior, times the controller of the parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from mavdem.condition.loop.margins import OpenLoop
from mavdem.condition.loop.response import (
    GAIN_ERROR,
    LEAST_BAND,
    MeasuredResponse,
    measured_response,
    transfer,
)
from mavdem.dem import Learned
from mavdem.dem.engine.linalg import Array
from mavdem.dem.graybox import Physical
from mavdem.dem.graybox.likelihood import DELAY
from mavdem.dem.graybox.wind import wind_density
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable, downstream
from mavdem.ingest.controllers import ASK, MOTORS, Controller, controller_of

# parameters of one axis begin so
OF_AXES = ("ATC_RAT_", "ATC_ANG_", "MC_ROLL", "MC_PITCH", "MC_YAW")
# of the plant's posterior
DRAWS = 400
SEED = 31
# Hz, and the number of frequencies between, evenly by ratio
LOWEST = 0.02
HIGHEST = 100.0
FREQUENCIES = 500
# of the posterior that is drawn: with all of it 98 % of 90 % intervals held simulated margins
SPREAD = 0.8
# of a step of the stream: standard deviation of a delay by the times between its samples
SPLIT = 0.25
HALF_DELAY = 2**-0.5
HALF_PHASE = 0.7560
HALF_SIZE = 0.9701
"""Of a second-order Butterworth filter at half of its cut-off, ω: its delay at low frequencies by ω, rad, and size."""
LEAST = 0.02, 1e-3, 0.0  # damping, 1/s, lag and delay, s, of a drawn plant


@dataclass(frozen=True, eq=False, repr=False)
class Loop:
    """The loops of one ``axis``: ``rate`` and, with that closed, ``attitude``; it has the figures of ``rate`` itself.

    They are of a ``plant`` that was identified from a ``record``, and its ``controller``. ``gains`` (N,) are angular
    acceleration per demand, rad/s², ``draws`` (N, 3) damping, 1/s, lag and delay, s, without the gyro's filter: of the
    estimate, and then drawn. ``cautions`` say what the figures do not allow for, one sentence each. ``measured`` is the
    response of the rate in flight, where the log has setpoints.
    """

    axis: str
    plant: Physical
    record: Record
    controller: Controller
    gains: Array
    draws: Array
    rate: OpenLoop
    attitude: OpenLoop
    cautions: tuple[str, ...]
    measured: MeasuredResponse | None = None

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(f"a Loop has no attribute {name!r}")
        return getattr(self.rate, name)

    def __repr__(self) -> str:
        margins = f"phase margin {self.phase_margin:.0f}°, gain margin {self.gain_margin:.1f} dB"
        return f"<Loop: {self.axis}, crossover {self.crossover:.2f} Hz, {margins}>"

    def changed(self, parameters: Mapping[str, float]) -> Loop:
        """Returns the loop with other values of some of the autopilot's ``parameters``, by name."""
        controller = self.controller.changed(parameters)
        rate, attitude = _loops(controller, self.gains, self.draws)
        return replace(self, controller=controller, rate=rate, attitude=attitude, measured=None)

    @property
    def agrees(self) -> bool | None:
        """Whether the flight's response is the predicted one; None where too little of it was measured."""
        found = self.measured
        if found is None or (
            found.band[1] < LEAST_BAND and not abs(np.log(found.controller_gain)) > GAIN_ERROR
        ):
            return None
        return not found.reason

    @cached_property
    def advice(self) -> Any:
        """Gains to set, with what to expect, or why there are none; see ``mavdem.condition.loop.advise``."""
        return downstream("condition.loop.advice", "advise")(self)

    @property
    def lean_in_wind(self) -> float:
        """Standard deviation of the angle, degrees, in the wind of the flight about its mean, by this loop."""
        frequency = self.attitude.frequency
        power = np.abs(self.attitude.disturbance[0]) ** 2 * wind_density(self.plant, frequency)
        return float(np.degrees(np.sqrt(np.trapezoid(power, frequency))))

    def as_dict(self) -> dict[str, Any]:
        """Returns the figures as plain JSON values."""
        loops = {"rate": self.rate.as_dict(), "attitude": self.attitude.as_dict()}
        found = self.measured
        compared = (
            {name: getattr(found, name) for name in ("band", "fit", "agreement", "reason")}
            if found
            else None
        )
        if found and compared and np.isfinite(found.controller_gain):
            compared |= {"controller_gain": found.controller_gain}
        known = {
            "axis": self.axis,
            **loops,
            "lean_in_wind": self.lean_in_wind,
            "cautions": list(self.cautions),
        }
        return known | {"measured": compared, "agrees": self.agrees}


def loop(learned: Learned, controller: Controller | None = None) -> Loop:
    """Returns the loops of what was ``learned``; the ``controller`` is that of the log's parameters unless given.

    Raises ``NotLearnable``: the plant is not identifiable, or the controller is not known.
    """
    if learned.physical is None:
        raise NotLearnable(learned.physical_reason)
    return loop_of(learned.physical, learned.record, controller)


def loop_of(plant: Physical, record: Record, controller: Controller | None = None) -> Loop:
    """Returns the loops of a ``plant`` identified from the ``record``, with a ``controller``, as :func:`loop` does."""
    if not isinstance(controller, Controller | None):
        raise ValueError(
            f"The loop takes a Controller, such as the one of another loop, and not {controller!r}."
        )
    if plant.caution is not None:
        raise NotLearnable(f"There are no margins: {plant.caution[0].lower()}{plant.caution[1:]}")
    axis = record.output_names[-1].removesuffix(" rate") if record.output_names else "roll"
    if controller is None:
        if not record.parameters:
            raise NotLearnable(
                "The autopilot's parameters are not known: there is no controller.", ASK
            )
        weights = [] if record.effect_directions is None else record.effect_directions.tolist()
        controller = controller_of(record.parameters, axis, weights)
    if not controller.p > 0:
        raise NotLearnable(
            f"{controller.names['p']} is {controller.p:g}: there is no loop to judge. Check the gains."
        )
    drawn = _drawn(plant, controller.gyro_filter, record.dt)
    gains = drawn[:, :-3] @ (per_demand := _per_demand(controller, record))
    if not gains[0] > 0:
        raise NotLearnable(
            "By the parameters the mixer turns the vehicle the wrong way: check FRAME_TYPE."
        )
    dynamics = np.maximum(drawn[:, -3:], LEAST)
    rate, attitude = _loops(controller, gains, dynamics)
    biased = f"The control effectiveness is biased: {plant.reasons['effect']}" if plant.bias else ""
    changed = changed_in(record, controller)
    now = [
        f"{name} changed from {old:g} to {record.parameters[name]:g}"
        for name, old in changed.items()
    ]
    since = f"{', '.join(now)} in this log: the loop has the last values, and the response is not compared."
    cautions = (*([biased] if biased else []), *([since] if now else []), *controller.cautions)
    measured = (
        None
        if now
        else measured_response(record, controller, per_demand, rate.frequency, rate.closed[0])
    )
    return Loop(
        axis, plant, record, controller, gains, dynamics, rate, attitude, cautions, measured
    )


def changed_in(record: Record, controller: Controller) -> dict[str, float]:
    """Returns the parameters of a ``controller`` that changed in the ``record``, with their values before."""
    known = controller.names.values()
    prefix = controller.names["p"][:-1]
    return {
        name: old
        for name, old in record.earlier.items()
        if name in known or name.startswith(prefix) or not name.startswith(OF_AXES)
    }


def _drawn(plant: Physical, cutoff: float, dt: float) -> Array:
    """(N, r + 3) effect, damping, lag and delay without the gyro's filter, Hz, if any: the estimate, and draws.

    The plant's lag and delay hold the filter. Where that is most of them, both are alike in size and phase at half of
    the cut-off, else in their delay at low frequencies. The sum of lag and delay is better determined than either: a
    delay is taken for that of common autopilots as far as the flight leaves it open, and the lag is what is left.
    """
    theta = np.array([*plant.effect, plant.damping, plant.lag, plant.delay])
    rng = np.random.default_rng(SEED)
    covariance = plant.covariance.copy()
    (usual, sd) = DELAY
    variance = covariance[-1, -1] + (SPLIT * dt) ** 2
    if covariance[-1, -1] > sd**2:
        covariance[-1] = 0.0
        covariance[:, -1] = 0.0
    drawn = np.vstack([theta, rng.multivariate_normal(theta, covariance, DRAWS, method="svd")])
    late = drawn[:, -2:].sum(axis=1)
    half = np.pi * cutoff
    open_ = variance / (variance + sd**2)
    filtered = HALF_DELAY / half if cutoff else 0.0
    whole = np.maximum(late - filtered, 0.0)
    if filtered > late[0] / 2:
        whole = np.maximum((np.arctan(half * drawn[:, -2]) - HALF_PHASE) / half + drawn[:, -1], 0.0)
        drawn[:, :-3] /= HALF_SIZE * np.hypot(1.0, half * drawn[:, -2])[:, None]
    delay = (1 - open_) * max(plant.delay - filtered, 0.0) + open_ * usual
    delay = np.clip(
        delay + sd * open_**0.5 * np.append(0.0, rng.standard_normal(DRAWS)), 0.0, whole / 2
    )
    drawn[:, -2:] = np.column_stack([whole - delay, delay])
    return np.asarray(drawn[0] + SPREAD * (drawn - drawn[0]))


def _per_demand(controller: Controller, record: Record) -> Array:
    """(r,) of the inputs, in their unit, by a demand of 1 about the trim; a demand itself is one."""
    trim = record.inputs.mean(axis=0)
    if len(trim) == 1 and record.input_range == (-1.0, 1.0):
        return np.ones(1)
    if len(trim) != MOTORS or len(record.input_range) != 2:
        raise NotLearnable(
            f"The mixer of {len(trim)} motors is not known: this needs a quadrotor's log."
        )
    low, high = record.input_range
    return (high - low) * np.array(controller.per_demand(((trim - low) / (high - low)).tolist()))


def _loops(controller: Controller, gains: Array, dynamics: Array) -> tuple[OpenLoop, OpenLoop]:
    frequency = np.geomspace(LOWEST, min(HIGHEST, 0.45 / controller.cycle), FREQUENCIES)
    s = 2j * np.pi * frequency
    damping, lag, delay = (column[:, None] for column in dynamics.T)
    # Rates are logged, and controlled, behind the gyro's filter, the angle is not.
    share = frequency / controller.gyro_filter if controller.gyro_filter else 0 * frequency
    filtered = 1 / (1 + 2**0.5 * 1j * share - share**2)
    acted = filtered * np.exp(-s * delay) / (lag * s + 1)
    turned = 1 / (s + damping)
    to_rate = gains[:, None] * acted * turned
    forward, back = transfer(controller, frequency)
    response = back * to_rate
    closed = forward * to_rate / (1 + response)
    rejected = turned / (1 + response)
    outer = controller.angle / s * closed / filtered
    attitude = OpenLoop.of(frequency, outer, outer / (1 + outer), rejected / s / (1 + outer))
    return OpenLoop.of(frequency, response, closed, rejected), attitude
