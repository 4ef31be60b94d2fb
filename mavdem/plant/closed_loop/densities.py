"""Densities that a closed loop gives its rate, output and setpoint, and how they change with each parameter.

    ṗ = −damping · p + effect · u(t − delay) behind a lag + wind,    u = C(rate setpoint, gyro) + actuation,
    gyro = filters · (p + noise),    rate setpoint = angle gain · (asked − angle),

The controller C runs once a cycle, and its response is known; so is that of the gyro's filters. What enters is Gaussian
and stationary: what is asked, white noise before and behind the gyro's filters and of the angle, and wind of three
colours. A share of the output's own density stands for whatever else the output did, such as limits: the larger it is,
the more the output counts as a known input. As the loop is closed in the model, noise that goes round it is not taken
for wind. What is sampled has at each frequency all that folds onto it (Brillinger, Time Series, sec. 7.6).

Steps are asked at the cycles of an outer loop, which keep time with the messages: then what folds is of one phase, that
of the time from a step to the next message, and not of any. How much of what is asked does so is a parameter too.
"""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, ArrayPair, Flags
from mavdem.plant.closed_loop.parameters import (
    CONTROLLER,
    DAMPING,
    DELAY,
    EFFECT,
    LAG,
    NAMES,
    STEP_TIME,
)
from mavdem.plant.closed_loop.spectra import Complex, CrossSpectra
from mavdem.plant.sampled_plant import FIRST_ORDER

Values = SimpleNamespace
"""Of parameters by name, no longer logarithms."""
RATE, OUTPUT, SETPOINT, ASKED = range(4)
"""Quantities of the spectra: the gyro's rate, rad/s; the output, as a demand; the rate setpoint, rad/s; and what was
asked, that is the setpoint plus what the angle takes off it, of which the density alone counts."""
ASKING, NOISE, ACTUATION, WIND = range(4)
"""Sources: what is asked, with the angle's noise; the gyro's noise; what the output does besides; and the wind."""
ACTS = (np.arange(WIND + 1) == ACTUATION)[:, None, None]
MODEL_SHARE = 0.02
"""Of the motors' torque, that a linear plant leaves out: a floor under the wind."""
READ_SHARE = 0.01  # of an output or a setpoint, by which it is another than the controller's
GYRO_NOISE = 1e-9
"""(rad/s)²/Hz, two-sided, of the best. Simulators' gyros have less, of which a model would be too sure."""
LEAST_ASKED = 0.05  # of the density that was seen, whatever of it is folded or noise


class KnownController(NamedTuple):
    """The controller of one axis as frequency responses, each of Hz (…), and its cycle."""

    # to the demand, from the rate setpoint and, without its sign, from the gyro's rate
    transfer: Callable[[Array], tuple[Complex, Complex]]
    gyro: Callable[[Array], Complex]  # from the rate to the gyro's
    angle: float  # of the rate setpoint by the angle's error, 1/s
    cycle: float  # s


class _Loop(NamedTuple):
    """What the loop makes of its S sources, at J frequencies and F that fold onto each."""

    turned: Complex  # (J, F) the rate by an acceleration, of the plant alone
    lagged: Complex  # (J, F) what comes of a command, by the motors' lag
    left: Complex  # (J, F) what the loop leaves of a disturbance
    by_rate: Complex  # (C, J, F) each quantity by the rate
    rates: Complex  # (S, J, F) the rate by each source
    seen: Complex  # (S, C, J, F) the quantities by each source


class _DensityPart(NamedTuple):
    """A part of a source's density, and the slopes of its logarithm by parameters."""

    source: int
    density: Array  # (J, F)
    slopes: dict[str, float | Array]


class _Steps(NamedTuple):
    """What is asked in steps that keep time, the slopes of its logarithm, and what it makes of the quantities."""

    density: Array  # (J, 1, 1)
    slopes: dict[str, float | Array]
    shape: Complex  # (J, F) share of each frequency that folds
    seen: Complex  # (J, C)


class Densities:
    """Densities of one axis's spectra by its controller and parameters in the order of ``NAMES``."""

    def __init__(self, spectra: CrossSpectra, controller: KnownController, rounding: float) -> None:
        """Prepares for the spectra of all four quantities; ``rounding`` is the output's step, as a demand."""
        self.known = controller
        self.rate = spectra.rate
        # beyond 1 kHz gyro filters leave nothing, and folds cost time
        highest = min(0.5 / controller.cycle, 1000.0)
        folds = np.arange(-np.ceil(highest / spectra.rate), np.ceil(highest / spectra.rate) + 1)
        frequency = spectra.frequency[:, None] + folds * spectra.rate
        self.inside = np.abs(frequency) < highest
        self.frequency = np.where(self.inside, frequency, 1.0)
        size = np.abs(self.frequency)
        seen = np.einsum("jaa->ja", spectra.mean).real
        self.output = np.interp(size, spectra.frequency, seen[:, OUTPUT]) * self.inside
        own = READ_SHARE**2 * seen[:, :ASKED]
        own[:, RATE] = GYRO_NOISE
        own[:, OUTPUT] /= 4
        own[:, OUTPUT] += rounding**2 / 12 / spectra.rate
        self.read = own[..., None] * np.eye(ASKED)
        self.s = 2j * np.pi * self.frequency
        self.turn = np.abs(self.s)
        self.forward, self.back = controller.transfer(self.frequency)
        self.gyro = controller.gyro(self.frequency)
        self.white = np.where(self.inside, controller.cycle, 0.0)
        self.asked_seen = seen[:, ASKED, None, None]
        unfolded = _unfolded(seen[:, ASKED], size, folds == 0, self.inside)
        self.asked = np.where(self.inside, unfolded, 1.0)
        late = np.array(spectra.late[:ASKED])
        self.turns = 2j * np.pi * spectra.rate * folds
        turns = np.exp(self.turns[:, None, None] * late)
        by_fold = turns @ turns.mT.conj() / late.shape[1]
        self.turned = by_fold.transpose(1, 2, 0)[:, :, None]  # (C, C, 1, F)
        # the angle that is taken off is of another cycle than the controller's, with noise of its own
        other = np.abs(late[SETPOINT] - late[RATE]) > controller.cycle / 2
        self.angle_noise = 2 * other.mean() * controller.angle**2
        self.between = max(1 / spectra.rate - controller.cycle, 0.0)
        self.step = self.inside / (1 - np.exp(-self.s * controller.cycle))

    def at(self, theta: Array, is_asked: bool = True) -> Complex:
        """Returns (J, C, C) of parameters θ (k,); of a vehicle of which something ``is_asked``, or nothing."""
        values = _values(theta)
        loop = self._loop(values)
        sources = _by_source(self._parts(values, loop, is_asked))
        whole = self.read + _of_steps(self._steps(values, loop, is_asked))
        for density, seen in zip(sources, loop.seen, strict=True):
            whole += self._folded(density[None], seen, seen.conj())[:, 0]
        return whole

    def with_slopes(self, theta: Array) -> tuple[Complex, Complex]:
        """Returns what ``at`` does, and (J, k, C, C) how it changes with each parameter."""
        values = _values(theta)
        loop = self._loop(values)
        parts = self._parts(values, loop)
        sources = _by_source(parts)
        steps = self._steps(values, loop)
        of_steps = _of_steps(steps)
        whole = self.read + of_steps
        slopes = np.zeros((len(whole), len(NAMES), ASKED, ASKED), complex)
        slopes[:, : CONTROLLER + 1] = self._by_loop(values, loop, sources, steps)
        slopes[:, STEP_TIME] = self._by_step_time(values, loop, steps)
        for name, slope in steps.slopes.items():
            slopes[:, NAMES.index(name)] += slope * of_steps
        for source, seen in enumerate(loop.seen):
            of_source = [
                (NAMES.index(name), part.density * slope)
                for part in parts
                if part.source == source
                for name, slope in part.slopes.items()
            ]
            rows, changes = zip(*of_source, strict=True)
            folded = self._folded(np.array([sources[source], *changes]), seen, seen.conj())
            whole += folded[:, 0]
            # one by one: a parameter of two parts has two rows
            for row, change in zip(rows, folded[:, 1:].swapaxes(0, 1), strict=True):
                slopes[:, row] += change
        return whole, slopes

    def _loop(self, values: Values) -> _Loop:
        forward, back = (values.controller * part for part in (self.forward, self.back))
        turned = 1 / (self.s + values.damping)
        lagged = 1 / (values.lag * self.s + 1)
        acted = values.effect * lagged * np.exp(-self.s * values.delay) * turned
        corrected = -self.known.angle / self.s
        by_rate = np.array([self.gyro, forward * corrected - back * self.gyro, corrected])
        left = 1 / (1 - acted * by_rate[OUTPUT])
        rates = left * np.array([acted * forward, -acted * back, acted, turned])
        seen = rates[:, None] * by_rate
        seen[ASKING, SETPOINT] += 1.0
        seen[ASKING, OUTPUT] += forward
        seen[NOISE, RATE] += 1.0
        seen[NOISE, OUTPUT] -= back
        seen[ACTUATION, OUTPUT] += 1.0
        return _Loop(turned, lagged, left, by_rate, rates, seen)

    def _parts(self, values: Values, loop: _Loop, is_asked: bool = True) -> list[_DensityPart]:
        share = _share(values.steps)
        asked, by_noise = _without(self.asked, self._angle_noise(values) * self.known.cycle)
        lagged = np.abs(loop.lagged) ** 2
        left_out = (MODEL_SHARE * values.effect) ** 2 * lagged * self.output
        white = self.white
        return [
            _DensityPart(
                ASKING,
                asked * self.inside * (is_asked * (1 - share)),
                {"steps": -share, "angle_noise": by_noise},
            ),
            _DensityPart(
                ASKING, (self.known.angle * values.angle_noise) ** 2 * white, {"angle_noise": 2.0}
            ),
            _DensityPart(NOISE, (values.noise * np.abs(self.gyro)) ** 2 * white, {"noise": 2.0}),
            _DensityPart(NOISE, values.unfiltered**2 * white, {"unfiltered": 2.0}),
            _DensityPart(ACTUATION, values.actuation**2 * self.output, {"actuation": 2.0}),
            _DensityPart(WIND, left_out, {"effect": 2.0, "lag": 2 * (lagged - 1)}),
            self._drift("drift", values.drift_size, values.drift_time),
            self._drift("eddy", values.eddy_size, values.eddy_time),
            self._gusts(values.gust_size, values.gust_time),
        ]

    def _drift(self, name: str, size: float, time: float) -> _DensityPart:
        """Wind of first order."""
        square = (self.turn * time) ** 2
        density = FIRST_ORDER.density(self.turn, size, time) * self.inside
        by_time = (1 - square) / (1 + square)
        return _DensityPart(WIND, density, {f"{name}_size": 2.0, f"{name}_time": by_time})

    def _gusts(self, size: float, time: float) -> _DensityPart:
        """Smooth wind, with the autocorrelation exp(−τ²/4 time²)."""
        square = (self.turn * time) ** 2
        density = 2 * np.sqrt(np.pi) * size**2 * time * self.inside * np.exp(-square)
        return _DensityPart(WIND, density, {"gust_size": 2.0, "gust_time": 1 - 2 * square})

    def _steps(self, values: Values, loop: _Loop, is_asked: bool = True) -> _Steps:
        share = _share(values.steps)
        shape = self.step * np.exp(self.turns * _share(values.step_time) * self.between)
        shape /= shape.sum(axis=-1, keepdims=True)
        asked, by_noise = _without(self.asked_seen, self._angle_noise(values) / self.rate)
        return _Steps(
            asked * (is_asked * share),
            {"steps": 1 - share, "angle_noise": by_noise},
            shape,
            self._in_steps(shape[None], loop.seen[ASKING])[:, 0],
        )

    def _angle_noise(self, values: Values) -> Array:
        """Of what was asked, by the angle that was added to it: its variance, (rad/s)²."""
        return self.angle_noise * values.angle_noise**2

    def _in_steps(self, shapes: Complex, seen: Complex) -> Complex:
        """(J, n, C) what steps of n ``shapes`` (n, J, F) make of what is ``seen`` (C, J, F) of all that is asked."""
        return shapes.swapaxes(0, 1) @ (seen * self.turned[:, SETPOINT]).transpose(1, 2, 0)

    def _folded(self, weights: NDArray[Any], left: Complex, right: Complex) -> Complex:
        """(J, n, C, C) products of ``left`` and ``right`` (C, J, F), with n weights (n, J, F), and all that folds."""
        products = (left[:, None] * right * self.turned).reshape(ASKED**2, *right.shape[1:])
        folded = weights.swapaxes(0, 1) @ products.transpose(1, 2, 0)
        return folded.reshape(*folded.shape[:2], ASKED, ASKED)

    def _by_loop(self, values: Values, loop: _Loop, sources: Array, steps: _Steps) -> Complex:
        """(J, 5, C, C) by the parameters of the plant and the controller."""
        of_damping = -values.damping * loop.turned
        of_lag = -values.lag * self.s * loop.lagged
        of_delay = -values.delay * self.s
        whole = np.ones_like(of_delay)
        seen = loop.seen.conj()
        by_source = sources * loop.rates
        every = loop.left * np.einsum("sjf,scjf->cjf", by_source, seen)
        # of less damping the wind makes more before the loop answers, of all else not
        but_wind = every - by_source[WIND] * seen[WIND]
        motors = np.array([whole, of_lag, of_delay])
        half = np.empty((len(whole), CONTROLLER + 1, ASKED, ASKED), complex)
        half[:, [EFFECT, LAG, DELAY]] = self._folded(motors, loop.by_rate, but_wind)
        half[:, [DAMPING]] = self._folded(of_damping[None], loop.by_rate, every)
        # the controller makes more of all but of what the output does besides
        asked = but_wind - by_source[ACTUATION] * seen[ACTUATION]
        half[:, [CONTROLLER]] = self._folded(whole[None], loop.by_rate, asked)
        demands = sources * (loop.seen[:, OUTPUT] - ACTS)
        demanded = np.einsum("sjf,scjf->cjf", demands, seen)
        half[:, CONTROLLER, OUTPUT] += (demanded * self.turned[OUTPUT]).sum(axis=-1).T
        relative = np.array([whole, of_damping, of_lag, of_delay, whole])
        asking = relative * (loop.left * loop.rates[ASKING] * steps.shape)
        in_steps = self._in_steps(asking, loop.by_rate)
        in_steps[:, CONTROLLER, OUTPUT] += steps.seen[:, OUTPUT]
        half += steps.density[..., None] * in_steps[..., None] * steps.seen[:, None, None].conj()
        return _with_adjoint(half)

    def _by_step_time(self, values: Values, loop: _Loop, steps: _Steps) -> Complex:
        """(J, C, C)."""
        late = _share(values.step_time)
        turns = self.turns * (self.between * late * (1 - late))
        turning = steps.shape * (turns - (steps.shape * turns).sum(axis=-1, keepdims=True))
        later = self._in_steps(turning[None], loop.seen[ASKING])[:, 0]
        return _with_adjoint(steps.density * _outer(later, steps.seen))


def _values(theta: Array) -> Values:
    return Values(**dict(zip(NAMES, np.exp(theta).tolist(), strict=True)))


def _share(odds: float) -> float:
    return odds / (1 + odds)


def _by_source(parts: Sequence[_DensityPart]) -> Array:
    """(S, J, F)."""
    sources = np.zeros((WIND + 1, *parts[0].density.shape))
    for part in parts:
        sources[part.source] += part.density
    return sources


def _of_steps(steps: _Steps) -> Complex:
    return steps.density * _outer(steps.seen, steps.seen)


def _outer(left: Complex, right: Complex) -> Complex:
    """(J, C, C) of (J, C) each."""
    return left[:, :, None] * right[:, None].conj()


def _with_adjoint(matrices: Complex) -> Complex:
    return matrices + matrices.mT.conj()


def _without(seen: Array, noise: Array) -> ArrayPair:
    """A density of what was asked without the ``noise`` in it, and its logarithm's slope by that of the noise."""
    less = np.maximum(seen - noise, LEAST_ASKED * seen)
    return less, np.where(less > LEAST_ASKED * seen, -2 * noise / less, 0.0)


def _unfolded(seen: Array, at: Array, first: Flags, inside: Flags) -> Array:
    """The density of what was asked: a power law with white noise where it is folded, what was seen less that, else."""
    from scipy.optimize import minimize  # it takes half a second to import

    def law(values: Array) -> Array:
        size, corner, slope, white = np.exp(values.clip(-50.0, [50.0, 50.0, 2.0, 50.0]))
        return size * (1 + (at / corner) ** 2) ** -slope + white

    def cost(values: Array) -> float:
        folded = np.where(inside, law(values), 0.0).sum(axis=1)
        return (np.log(folded) + seen / folded).sum()

    start = np.array(
        [np.log(seen[:5].mean()), 0.0, -0.35, np.log(np.median(seen[-5:]) / len(first))]
    )
    phases = minimize(cost, start, method="Nelder-Mead", options={"maxiter": 600}).x
    whole = np.where(inside, law(phases), 0.0)
    folded = whole[:, ~first].sum(axis=1)
    whole[:, first] = np.maximum(seen - folded, LEAST_ASKED * seen)[:, None]
    return whole
