"""The likelihood of a closed loop whose controller is known: spectra of rate, output and setpoint, and their densities.

    ṗ = −damping · p + effect · u(t − delay) behind a lag + wind,    u = C(rate setpoint, gyro) + actuation,
    gyro = filters · (p + noise),    rate setpoint = angle gain · (asked − angle),

The controller C runs once a cycle, and its response is known; so is that of the gyro's filters. What enters is Gaussian
and stationary: what is asked, wind of three colours, and white noise before and behind the gyro's filters and of the
angle. A share of the output's own density stands for whatever else the output did, such as limits: the larger it is,
the more the output counts as a known input. As the loop is closed in the model, noise that goes round it is not taken
for wind. Whittle's likelihood of the spectra in bands has, at each frequency, all that folds onto it (Brillinger, Time
Series, secs. 5.6 and 7.6).

Steps are asked at the cycles of an outer loop, which keep time with the messages: then what folds is of one phase, that
of the time from a step to the next message, and not of any. How much of what is asked does so is a parameter too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.closed_loop.spectra import Complex, Spectra
from mavdem.dem.engine.linalg import Array

Flags = NDArray[np.bool_]
RATE, OUTPUT, SETPOINT, ASKED = range(4)
"""Quantities of the spectra: the gyro's rate, rad/s; the output, as a demand; the rate setpoint, rad/s; and what was
asked, that is the setpoint plus what the angle takes off it, of which the density alone counts."""
MODEL_SHARE = 0.02
"""Of the motors' torque, that a linear plant leaves out: a floor under the wind."""
READ_SHARE = 0.01  # of an output or a setpoint, by which it is another than the controller's
DEPENDENT = 6.25
"""Values of the spectra that count as one: winds differ from window to window, and no flight is linear or stationary.
What is known beforehand counts whole, so that slow logs, which leave lag and delay open, keep to it."""


LEAST_ASKED = 0.05  # of the density that was seen, whatever of it is folded or noise


class KnownController(NamedTuple):
    """The controller of one axis as frequency responses, each of Hz (…), and its cycle."""

    # to the demand, from the rate setpoint and, without its sign, from the gyro's rate
    transfer: Callable[[Array], tuple[Complex, Complex]]
    gyro: Callable[[Array], Complex]  # from the rate to the gyro's
    angle: float  # of the rate setpoint by the angle's error, 1/s
    cycle: float  # s


class Prior(NamedTuple):
    """Mean and standard deviation beforehand."""

    mean: float
    sd: float


PRIORS = {
    "effect": Prior(np.log(300.0), 2.0),
    "damping": Prior(0.0, 1.5),
    "lag": Prior(np.log(0.03), 0.5),
    "delay": Prior(np.log(0.006), 0.6),
    "controller": Prior(0.0, 0.1),
    "steps": Prior(0.0, 2.0),
    "step_time": Prior(0.0, 1.5),
    "drift_size": Prior(np.log(3.0), 2.0),
    "drift_time": Prior(0.0, 1.0),
    "eddy_size": Prior(np.log(3.0), 2.0),
    "eddy_time": Prior(np.log(0.05), 1.0),
    "gust_size": Prior(np.log(3.0), 2.0),
    "gust_time": Prior(np.log(0.07), 1.0),
    "noise": Prior(np.log(0.005), 2.0),
    "unfiltered": Prior(np.log(0.005), 2.0),
    "angle_noise": Prior(np.log(5e-4), 1.0),
    "actuation": Prior(np.log(0.03), 1.0),
}
"""Logarithms: effect in rad/s² per demand, damping in 1/s, sizes in rad/s², noise before and behind the gyro's filters
and of the angle in rad/s and rad, all times in s. The controller's is its gain over the parameters'; ``steps`` is what
of the asked are steps that keep time, over what is not; ``step_time`` the time from one to the next message, over the
rest of that between messages; ``actuation`` a share of the output. Turbulence takes seconds to pass a hovering vehicle,
and eddies of its own span some hundredths: of one colour for both, wind that is answered makes an effect too large by
half, with a lag as much too long. Widths as of common multirotors and autopilots."""
NAMES = tuple(PRIORS)
MEAN, SD = np.array(list(PRIORS.values())).T
PLANT = NAMES.index("effect"), NAMES.index("damping"), NAMES.index("lag"), NAMES.index("delay")
CONTROLLER, STEP_TIME = NAMES.index("controller"), NAMES.index("step_time")


class Axis:
    """Densities of one axis's spectra as its controller, and parameters in the order of ``NAMES``, have them."""

    def __init__(
        self, spectra: Spectra, controller: KnownController, rounding: float, limited: float = 0.0
    ) -> None:
        """Prepares for the spectra of all four quantities; ``rounding`` is the output's step, as a demand.

        ``limited`` is the share of the output's power while it is at a limit. What the controller asks beyond does not
        come: it acts as one of less gain, by all of that share where all of the output is cut (J. J. Bussgang, MIT RLE
        Report 216, 1952), by less where other motors make up for it.
        """
        self.spectra = spectra.of((RATE, OUTPUT, SETPOINT))
        self.known = controller
        self.limited = min(limited, 0.95)
        less = -np.log1p(-self.limited) / 2
        of_controller = np.arange(len(NAMES)) == CONTROLLER
        self.mean = MEAN - less * of_controller
        self.sd: Array = SD + less * of_controller
        # beyond 1 kHz gyro filters leave nothing, and folds cost time
        highest = min(0.5 / controller.cycle, 1000.0)
        folds = np.arange(-np.ceil(highest / spectra.rate), np.ceil(highest / spectra.rate) + 1)
        frequency = spectra.frequency[:, None] + folds * spectra.rate
        self.inside = np.abs(frequency) < highest
        self.frequency = np.where(self.inside, frequency, 1.0)
        size = np.abs(self.frequency)
        mean = spectra.mean
        self.seen = mean[:, :ASKED, :ASKED]
        self.weights = spectra.counts * len(spectra.densities) / DEPENDENT
        seen = mean[:, OUTPUT, OUTPUT].real
        self.output = np.interp(size, spectra.frequency, seen)
        asked_for = mean[:, SETPOINT, SETPOINT].real
        rounded = rounding**2 / 12 / spectra.rate
        own = [
            np.full_like(seen, 1e-8),
            READ_SHARE**2 / 4 * seen + rounded,
            READ_SHARE**2 * asked_for,
        ]
        self.read = np.array(own)
        self.forward, self.back = controller.transfer(self.frequency)
        self.gyro = controller.gyro(self.frequency)
        asked = mean[:, ASKED, ASKED].real
        self.asked = _unfolded(asked, size, folds == 0, self.inside)
        late = np.array(self.spectra.late)
        self.turns = 2j * np.pi * spectra.rate * folds
        turns = self.turns[:, None, None]
        self.turned = np.exp(turns[..., None] * (late[:, None] - late[None])).mean(axis=-1)
        self.stamps = np.exp(turns * (late - late[SETPOINT])).mean(axis=-1)
        self.asked_seen = asked
        # the angle that is taken off is of another cycle than the controller's, with noise of its own
        other = np.abs(late[SETPOINT] - late[RATE]) > controller.cycle / 2
        self.asked_noise = 2 * float(other.mean()) * controller.angle**2
        self.between = max(1 / spectra.rate - controller.cycle, 0.0)
        self.step = self.inside / (1 - np.exp(-2j * np.pi * self.frequency * controller.cycle))

    def densities(self, thetas: Array, is_asked: bool = True) -> Complex:
        """Returns (b, J, C, C) of parameters (b, k); of a vehicle of which something ``is_asked``, or nothing.

        They are of one plant: alike in ``NAMES`` up to the controller.
        """
        values = dict(zip(NAMES, np.exp(thetas.T)[..., None, None], strict=True))
        damping, lag, delay, controller = (
            values[name][0] for name in ("damping", "lag", "delay", "controller")
        )
        s = 2j * np.pi * self.frequency
        turned = 1 / (s + damping)
        effect = values["effect"][0] / (lag * s + 1)
        acted = effect * np.exp(-s * delay) * turned
        forward = controller * self.forward
        back = controller * self.back
        corrects = self.known.angle / s
        # The loop, opened at the true rate; and what each source makes of the rate: what was asked, wind, noise before
        # and behind the gyro's filters, the angle's, and what the output did besides.
        closed = 1 / (1 + acted * (self.gyro * back + forward * corrects))
        noisy = -acted * back
        asked = acted * forward
        rates = closed * np.array(
            [asked, turned, noisy * self.gyro, noisy, -asked * self.known.angle, acted]
        )
        gyro = self.gyro * rates
        gyro[2] += self.gyro
        gyro[3] += 1.0
        setpoint = -corrects * rates
        setpoint[0] += 1.0
        setpoint[4] -= self.known.angle
        output = forward * setpoint - back * gyro
        output[5] += 1.0
        seen = gyro, output, setpoint
        turn = np.abs(s)
        wind = _drift(turn, values["drift_size"], values["drift_time"])
        wind += _drift(turn, values["eddy_size"], values["eddy_time"])
        wind += _gusts(turn, values["gust_size"], values["gust_time"])
        wind += MODEL_SHARE**2 * np.abs(effect) ** 2 * self.output
        steps, late = (values[name] / (1 + values[name]) for name in ("steps", "step_time"))
        noise = self.asked_noise * values["angle_noise"] ** 2
        size = (
            is_asked * _without(self.asked_seen, noise[..., 0] / self.spectra.rate) * steps[..., 0]
        )
        white = np.full_like(turn, self.known.cycle)
        sources = np.array(
            [
                _without(self.asked, noise * self.known.cycle) * (is_asked * (1 - steps)),
                wind,
                *(white * values[name] ** 2 for name in ("noise", "unfiltered", "angle_noise")),
                values["actuation"] ** 2 * self.output,
            ]
        )
        sources *= self.inside
        step = self.step * np.exp(self.turns * late * self.between)
        step /= step.sum(axis=-1, keepdims=True)
        of_steps = [
            (density[0] * step) @ at for density, at in zip(seen, self.stamps.T, strict=True)
        ]
        number, bands, _ = step.shape
        by_band = np.moveaxis(sources, (2, 1), (0, 1)).reshape(bands, number, -1)
        parts = [np.ascontiguousarray(np.moveaxis(density, 1, 0)) for density in seen]
        whole = np.empty((number, bands, ASKED, ASKED), complex)
        for i, part in enumerate(parts):
            for t, other in enumerate(parts[: i + 1]):
                folded = part * (other.conj() * self.turned[:, i, t])
                # Matrices of real numbers: of complex ones NumPy would make the sources complex.
                split = folded.reshape(bands, -1, 1).view(np.float64)
                pair = (by_band @ split).view(np.complex128)[..., 0].T
                whole[..., i, t] = pair + size * of_steps[i] * of_steps[t].conj()
                whole[..., t, i] = whole[..., i, t].conj()
            whole[..., i, i] += self.read[i]
        return whole

    def value(self, theta: Array) -> float:
        """Returns the log likelihood, up to a constant; minus infinity where there is none."""
        return self._log_likelihood(self.densities(theta[None])[0])

    def _log_likelihood(self, model: Complex) -> float:
        sign, size = np.linalg.slogdet(model)
        if not (np.isfinite(size).all() and (sign.real > 0).all()):
            return -np.inf
        unlike = np.einsum("jab,jba->j", np.linalg.inv(model), self.seen).real
        return -float(self.weights @ (size + unlike))

    def scores(self, theta: Array, steps: Array) -> tuple[float, Array, Array]:
        """Returns the log likelihood as ``value`` does, its slope (k,), and Fisher's information (k, k)."""
        near = theta + np.diag(steps)
        # What acts on a plant is changed at once, the plant itself one parameter after the other.
        acting = self.densities(np.vstack([theta, near[CONTROLLER + 1 :]]))
        here = acting[0]
        there = np.concatenate([*map(self.densities, near[: CONTROLLER + 1, None]), acting[1:]])
        inverse = np.linalg.inv(here)
        slopes = inverse @ ((there - here) / steps[:, None, None, None])
        unlike = inverse @ self.seen - np.eye(ASKED)
        score = np.einsum("j,kjab,jba->k", self.weights, slopes, unlike).real
        weighted = slopes * self.weights[:, None, None]
        flat = weighted.reshape(len(steps), -1)
        other = slopes.mT.reshape(len(steps), -1)
        return self._log_likelihood(here), score, (flat @ other.T).real

    def steered_share(self, theta: Array) -> float:
        """Returns the share of the rate's variance that follows what was asked, by parameters θ."""
        whole, unasked = (
            self.densities(theta[None], is_asked)[0, :, RATE, RATE].real
            for is_asked in (True, False)
        )
        width = np.gradient(self.spectra.frequency)
        return 1 - float(width @ unasked) / float(width @ whole)


def _without(seen: Array, noise: Array) -> Array:
    """A density of what was asked without that of ``noise`` which is in it."""
    return np.maximum(seen - noise, LEAST_ASKED * seen)


def _drift(turn: Array, size: Array, time: Array) -> Array:
    """The density of noise of first order, with this standard deviation and time, at rad/s."""
    return 2 * size**2 * time / (1 + (turn * time) ** 2)


def _gusts(turn: Array, size: Array, time: Array) -> Array:
    """Likewise of smooth noise, with the autocorrelation exp(−τ²/4 time²)."""
    return np.asarray(2 * np.sqrt(np.pi) * size**2 * time * np.exp(-((turn * time) ** 2)))


def _unfolded(seen: Array, at: Array, first: Flags, inside: Flags) -> Array:
    """The density of what was asked: a power law with white noise where it is folded, what was seen less that, else."""
    from scipy.optimize import minimize  # it takes half a second to import

    def law(values: Array) -> Array:
        size, corner, slope, white = np.exp(values.clip(-50.0, [50.0, 50.0, 2.0, 50.0]))
        return np.asarray(size * (1 + (at / corner) ** 2) ** -slope + white)

    def cost(values: Array) -> float:
        folded = np.where(inside, law(values), 0.0).sum(axis=1)
        return float((np.log(folded) + seen / folded).sum())

    start = np.array(
        [np.log(seen[:5].mean()), 0.0, -0.35, np.log(np.median(seen[-5:]) / len(first))]
    )
    phases = minimize(cost, start, method="Nelder-Mead", options={"maxiter": 600}).x
    whole = np.where(inside, law(phases), 0.0)
    folded = whole[:, ~first].sum(axis=1)
    whole[:, first] = np.maximum(seen - folded, LEAST_ASKED * seen)[:, None]
    return whole
