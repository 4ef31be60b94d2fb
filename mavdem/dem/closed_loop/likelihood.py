"""The likelihood of a closed loop whose controller is known: spectra of rate, output and setpoint, and their densities.

    ṗ = −damping · p + effect · u(t − delay) behind a lag + wind,    u = C(rate setpoint, gyro) + actuation,
    gyro = filters · (p + noise),    rate setpoint = angle gain · (asked − angle),

The controller C runs once a cycle, and its response is known; so is that of the gyro's filters. What enters is Gaussian
and stationary: what is asked, wind of two colours, and white noise of gyro and angle. A share of the output's own
density stands for whatever else the output did, such as limits: the larger it is, the more the output counts as a known
input. As the loop is closed in the model, noise that goes round it is not taken for wind. Whittle's likelihood of the
spectra in bands has, at each frequency, all that folds onto it (Brillinger, Time Series, secs. 5.6 and 7.6).
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


class KnownController(NamedTuple):
    """The controller of one axis as frequency responses, each of Hz (…), and its cycle."""

    forward: Callable[[Array], Complex]  # from the rate setpoint to the demand
    back: Callable[[Array], Complex]  # from the gyro's rate, without its sign
    gyro: Callable[[Array], Complex]  # from the rate to the gyro's
    angle: float  # of the rate setpoint by the angle's error, 1/s
    cycle: float  # s


class Prior(NamedTuple):
    """Mean and standard deviation beforehand."""

    mean: float
    sd: float


PRIORS = {
    "effect": Prior(np.log(300.0), 2.0),
    "damping": Prior(np.log(2.0), 1.0),
    "lag": Prior(np.log(0.03), 1.0),
    "delay": Prior(np.log(0.006), 0.8),
    "controller": Prior(0.0, 0.1),
    "output_late": Prior(0.0, 3e-4),
    "setpoint_late": Prior(0.0, 1.5e-3),
    "drift_size": Prior(np.log(3.0), 2.0),
    "drift_time": Prior(0.0, 1.0),
    "gust_size": Prior(np.log(3.0), 2.0),
    "gust_time": Prior(np.log(0.07), 1.0),
    "noise": Prior(np.log(0.005), 2.0),
    "angle_noise": Prior(np.log(5e-4), 1.0),
    "actuation": Prior(np.log(0.03), 1.0),
}
"""Logarithms but for lateness: effect in rad/s² per demand, damping in 1/s, sizes in rad/s², noise of gyro and angle in
rad/s and rad, all times in s. The controller's is its gain over the parameters'; ``actuation`` is a share of the
output. Widths as of common multirotors and their autopilots; a message is at most a few milliseconds late."""
NAMES = tuple(PRIORS)
PLANT = NAMES.index("effect"), NAMES.index("damping"), NAMES.index("lag"), NAMES.index("delay")
LATE = NAMES.index("output_late"), NAMES.index("setpoint_late")


class Axis:
    """Densities of one axis's spectra as its controller, and parameters in the order of ``NAMES``, have them."""

    def __init__(self, spectra: Spectra, known: KnownController, rounding: float) -> None:
        """Prepares for the spectra of all four quantities; ``rounding`` is the output's step, as a demand."""
        self.spectra = spectra.of((RATE, OUTPUT, SETPOINT))
        self.known = known
        # beyond 1 kHz gyro filters leave nothing, and folds cost time
        highest = min(0.5 / known.cycle, 1000.0)
        folds = np.arange(-np.ceil(highest / spectra.rate), np.ceil(highest / spectra.rate) + 1)
        frequency = spectra.frequency[:, None] + folds * spectra.rate
        self.inside = np.abs(frequency) < highest
        self.frequency = np.where(self.inside, frequency, 1.0)
        size = np.abs(self.frequency)
        mean = spectra.mean
        self.seen = mean[:, :ASKED, :ASKED]
        self.weights = spectra.counts * len(spectra.densities)
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
        self.forward = known.forward(self.frequency)
        self.back = known.back(self.frequency)
        self.gyro = known.gyro(self.frequency)
        asked = mean[:, ASKED, ASKED].real
        self.asked = _unfolded(asked, size, folds == 0, self.inside)
        late = np.array(self.spectra.late)
        turns = 2j * np.pi * spectra.rate * folds[:, None, None, None]
        self.turned = np.exp(turns * (late[:, None] - late[None])).mean(axis=-1)

    def densities(self, theta: Array, is_asked: bool = True) -> Complex:
        """Returns (J, C, C) of parameters θ; of a vehicle of which something ``is_asked``, or nothing."""
        values = dict(zip(NAMES, np.exp(theta), strict=True))
        values |= {
            name: float(theta[NAMES.index(name)]) for name in ("output_late", "setpoint_late")
        }
        s = 2j * np.pi * self.frequency
        turned = 1 / (s + values["damping"])
        effect = values["effect"] / (values["lag"] * s + 1)
        acted = effect * np.exp(-s * values["delay"]) * turned
        forward = values["controller"] * self.forward
        late = forward * np.exp(-s * values["setpoint_late"])
        back = values["controller"] * self.back
        corrects = self.known.angle / s
        # The loop, opened at the true rate; and what each source makes of the rate: what was asked, wind, the gyro's
        # noise, the angle's, and what the output did besides.
        closed = 1 / (1 + acted * (self.gyro * back + late * corrects))
        rates = closed * np.array(
            [
                acted * late,
                turned,
                -acted * back * self.gyro,
                -acted * late * self.known.angle,
                acted,
            ]
        )
        own = np.zeros((5, 3, 1, 1))
        own[2, 0] = own[0, 1] = own[4, 2] = 1.0
        gyro = self.gyro * (rates + own[:, 0])
        setpoint = own[:, 1] - corrects * rates
        setpoint[3] -= self.known.angle
        output = forward * setpoint - back * gyro + own[:, 2]
        output *= np.exp(-s * values["output_late"])
        turn = np.abs(s)
        wind = _drift(turn, values["drift_size"], values["drift_time"])
        wind += _gusts(turn, values["gust_size"], values["gust_time"])
        wind += MODEL_SHARE**2 * np.abs(effect) ** 2 * self.output
        cycle = self.known.cycle
        sources = np.array(
            [
                self.asked * is_asked,
                wind,
                np.full_like(turn, values["noise"] ** 2 * cycle),
                np.full_like(turn, values["angle_noise"] ** 2 * cycle),
                values["actuation"] ** 2 * self.output,
            ]
        )
        seen = np.where(self.inside, np.array([gyro, output, setpoint]), 0.0)
        pairs = np.einsum("isjk,tsjk->itjk", seen * sources, seen.conj())
        whole = np.einsum("itjk,kit->jit", pairs, self.turned)
        diagonal = np.arange(len(seen))
        whole[:, diagonal, diagonal] += self.read.T
        return np.asarray(whole)

    def value(self, theta: Array) -> float:
        """Returns the log likelihood, up to a constant; minus infinity where there is none."""
        model = self.densities(theta)
        sign, size = np.linalg.slogdet(model)
        if not (np.isfinite(size).all() and (sign.real > 0).all()):
            return -np.inf
        unlike = np.einsum("jab,jba->j", np.linalg.inv(model), self.seen).real
        return -float(self.weights @ (size + unlike))

    def scores(self, theta: Array, steps: Array) -> tuple[Array, Array]:
        """Returns the slope (k,) of the log likelihood, and Fisher's information (k, k)."""
        inverse = np.linalg.inv(self.densities(theta))
        slopes = np.array(
            [
                inverse @ (self.densities(theta + step) - self.densities(theta - step))
                for step in np.diag(steps)
            ]
        )
        slopes /= 2 * steps[:, None, None, None]
        unlike = inverse @ self.seen - np.eye(inverse.shape[-1])
        score = np.einsum("j,kjab,jba->k", self.weights, slopes, unlike).real
        weighted = slopes * self.weights[:, None, None]
        flat = weighted.reshape(len(steps), -1)
        other = np.swapaxes(slopes, 2, 3).reshape(len(steps), -1)
        return score, (flat @ other.T).real

    @property
    def prior(self) -> tuple[Array, Array]:
        """Mean and standard deviation (k,); what messages bring at every cycle is not late."""
        mean, sd = np.array(list(PRIORS.values())).T
        between = max(1 / self.spectra.rate - self.known.cycle, 0.0)
        at = NAMES.index("setpoint_late")
        sd[at] = min(sd[at], between / 4 + 1e-4)
        return mean, sd

    def steered_share(self, theta: Array) -> float:
        """Returns the share of the rate's variance that follows what was asked, by parameters θ."""
        whole, unasked = (
            self.densities(theta, is_asked)[:, RATE, RATE].real for is_asked in (True, False)
        )
        width = np.gradient(self.spectra.frequency)
        return 1 - float(width @ unasked) / float(width @ whole)


def _drift(turn: Array, size: float, time: float) -> Array:
    """The density of noise of first order, with this standard deviation and time, at rad/s."""
    return 2 * size**2 * time / (1 + (turn * time) ** 2)


def _gusts(turn: Array, size: float, time: float) -> Array:
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
    found = minimize(cost, start, method="Nelder-Mead", options={"maxiter": 600}).x
    whole = np.where(inside, law(found), 0.0)
    folded = whole[:, ~first].sum(axis=1)
    whole[:, first] = np.maximum(seen - folded, 0.05 * seen)[:, None]
    return whole
