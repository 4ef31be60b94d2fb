"""Airflow: the wind as a coloured unknown cause of the specific force that drag makes, given attitude and velocity.

On a grid of some tenths of a second, the specific force along body x and y is measured,

    f = b − (c + q |u|) u + e,   u = Rᵀ (v − m − w),

with velocity v, attitude R, white noise e, and the unknown cause w + m: gusts w, an Ornstein-Uhlenbeck process of mean
η = 0, about a wind m that changes as a random walk. An extended Kalman filter runs for many values of c, q, lean b, and
sizes of w, m and e side by side. Its likelihood weighs them; its smoother, averaged over them, is the estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from scipy.constants import g as GRAVITY  # noqa: N812
from scipy.spatial.transform import Rotation

from mavdem.arrays import Array, ArrayPair, Flags
from mavdem.confidence import coverage_factor
from mavdem.containers import JsonValues
from mavdem.dem.engine.linalg import require_positive_definite
from mavdem.facts.online import DragSource
from mavdem.immutable import ImmutableResult

POPULATION = np.log([0.3, 0.014, 1.0, 1.0])
POPULATION_SD = np.array([0.7, 0.9, 0.2, 0.35])
"""Logarithms of linear drag (1/s), quadratic drag (1/m) and the ratio of body y to x of each: of 9 vehicles, 3 real,
whose linear drag is 0.15 to 0.6; PX4's simulator SIH has 1."""
LEAN_SD = 0.18
LEAN_CHANGE = 0.1
"""m/s² of lean that no wind makes: 1° of misaligned attitude or shifted load, and of it what one flight only has, as a
Solo beside an anemometer. PX4's simulator draws 0.05 to 0.4 m/s² of accelerometer bias a flight."""
# kg/m³ at sea level, by which both autopilots define a ballistic coefficient
HALF_AIR_DENSITY = 1.225 / 2
# of the logarithm of a coefficient that somebody set in the autopilot: few are calibrated
SET_SD = 0.3
PARAMETERS = {
    "ARDUPILOTMEGA": ("EK3_DRAG_MCOEF", "EK3_DRAG_BCOEF_"),
    "PX4": ("EKF2_MCOEF", "EKF2_BCOEF_"),
}
"""Of momentum drag, 1/s at sea level, and of the ballistic coefficient along X and Y, kg/m²: 0.5 ρ / q."""
DEFAULTS = {"EKF2_MCOEF": (0.15,), "EKF2_BCOEF_X": (25.0, 100.0), "EKF2_BCOEF_Y": (25.0, 100.0)}
"""PX4 has these unless somebody sets others; ArduPilot has 0, which switches the model off."""
AXES = np.array([-0.5, 0.5])


def coefficients(logs: Array) -> ArrayPair:
    """Returns linear (…, 2) 1/s and quadratic (…, 2) 1/m drag along body x and y, of ``logs`` (…, 4 or more)."""
    c, q, c_ratio, q_ratio = (logs[..., [k]] for k in range(4))
    return np.exp(c + c_ratio * AXES), np.exp(q + q_ratio * AXES)


# from the population's means: factors of 50 to 400, and m/s²
FARTHEST = np.array([4.0, 6.0, 3.0, 3.0, 5.0, 5.0])


@dataclass(frozen=True, eq=False)
class Drag(ImmutableResult):
    """Drag of one vehicle, per mass, with its uncertainty.

    Attributes:
        mean: (6,) of ln c and ln q, geometric over both axes, of ln c_y/c_x and ln q_y/q_x, and of :attr:`lean`.
        covariance: (6, 6) of these.
        source: what it is known from.
    """

    mean: Array
    covariance: Array
    source: DragSource = DragSource.POPULATION

    @classmethod
    def of_parameters(
        cls, autopilot: str = "", parameters: Mapping[str, float] = MappingProxyType({})
    ) -> Drag:
        """Returns the population's drag, and what the ``autopilot``'s own ``parameters`` say where they were set."""
        momentum, ballistic = PARAMETERS.get(autopilot, ("", ""))
        names = momentum, f"{ballistic}X", f"{ballistic}Y"
        changed = {
            name: value
            for name, value in parameters.items()
            if round(value, 6) not in DEFAULTS.get(name, ())
        }
        m, x, y = (changed.get(name, 0.0) for name in names)
        logs = POPULATION.copy()
        sd = POPULATION_SD.copy()
        source = DragSource.POPULATION
        if m > 0.001:  # below, EKF2 takes the part for switched off
            logs[0] = np.log(m)
            sd[0] = SET_SD
            source = DragSource.PARAMETERS
        if x > 1 and y > 1:
            logs[[1, 3]] = np.log([HALF_AIR_DENSITY / np.sqrt(x * y), x / y])
            sd[[1, 3]] = SET_SD
            source = DragSource.PARAMETERS
        return cls(
            np.append(logs, [0.0, 0.0]), np.diag(np.append(sd, [LEAN_SD, LEAN_SD]) ** 2), source
        )

    @classmethod
    def given(cls, drag: Drag | None) -> Drag:
        """Returns a ``drag`` that a vehicle can have, the population's for None; ``ValueError`` for anything else."""
        if drag is None:
            return cls.of_parameters()
        if not isinstance(drag, cls):
            raise ValueError(f"drag must be a Drag, not {drag!r}")
        return drag.required()

    @property
    def linear(self) -> Array:
        """Linear drag (2,) along body x and y, 1/s: medians."""
        return coefficients(self.mean)[0]

    @property
    def quadratic(self) -> Array:
        """Likewise the quadratic drag (2,), 1/m."""
        return coefficients(self.mean)[1]

    @property
    def lean(self) -> Array:
        """Specific force (2,) along body x and y that no wind makes, m/s²."""
        return self.mean[4:]

    def interval(self, name: str) -> Array:
        """Returns (2, 2) lower and upper ends, by axis, of the 90 % interval of ``name``: linear or quadratic."""
        read = np.zeros((2, 6))
        read[:, [0, 2] if name == "linear" else [1, 3]] = np.column_stack([np.ones(2), AXES])
        half = coverage_factor() * np.sqrt(np.diag(read @ self.covariance @ read.T))
        return getattr(self, name) * np.exp(np.outer([-1, 1], half))

    def relative_sd(self, speed: float) -> float:
        """Returns the relative standard deviation of the drag at an air ``speed``, m/s."""
        parts = np.exp(self.mean[:2]) * [1.0, speed]
        return float(np.sqrt(parts @ self.covariance[:2, :2] @ parts) / parts.sum())

    def parameters(self, autopilot: str) -> dict[str, tuple[float, float, float]]:
        """Returns the ``autopilot``'s parameters to set, with both ends of 90 % intervals; empty without any."""
        if autopilot not in PARAMETERS:
            return {}
        momentum, ballistic = PARAMETERS[autopilot]
        (low, high) = self.interval("linear").mean(axis=1)
        ends = self.interval("quadratic")
        values = {momentum: (float(np.exp(self.mean[0])), float(low), float(high))}
        bodies = HALF_AIR_DENSITY / np.array([self.quadratic, *ends[::-1]]).T
        return values | {
            ballistic + axis: tuple(body.tolist()) for axis, body in zip("XY", bodies, strict=True)
        }

    def of_next_flight(self) -> Drag:
        """Returns what is known before another flight of the vehicle: a part of its lean is that of this one only."""
        kept = 1 - (LEAN_CHANGE / LEAN_SD) ** 2
        scale = np.array([1, 1, 1, 1, kept, kept])
        change = np.diag([0, 0, 0, 0, 1, 1]) * LEAN_SD**2 * (1 - kept**2)
        return Drag(
            self.mean * scale, self.covariance * np.outer(scale, scale) + change, self.source
        )

    def as_dict(self) -> JsonValues:
        """Returns plain JSON values, which :meth:`from_dict` reads."""
        return {
            "linear": self.linear.tolist(),
            "quadratic": self.quadratic.tolist(),
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
            "linear_interval": self.interval("linear").tolist(),
            "quadratic_interval": self.interval("quadratic").tolist(),
            "source": self.source,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Drag:
        """Returns the drag whose ``values`` :meth:`as_dict` made; ``ValueError`` or ``KeyError`` for others."""
        mean, covariance = (np.array(values[name], float) for name in ("mean", "covariance"))
        source = DragSource(values["source"])
        return cls(mean.reshape(6), covariance.reshape(6, 6), source).required()

    def required(self) -> Drag:
        """Returns it; ``ValueError`` where no vehicle can have it."""
        if np.shape(self.mean) != (6,):
            raise ValueError(f"a drag has a mean of 6 numbers, not {np.shape(self.mean)}")
        if not (abs(self.mean - np.append(POPULATION, np.zeros(2))) <= FARTHEST).all():
            raise ValueError("no vehicle has such a drag")
        require_positive_definite(self.covariance, "covariance", 6)
        return self


# m/s along each axis, of the mean wind before the flight: 3 to 10 are usual
WIND_SD = 5.0
# s between attitude and velocity; share of an acceleration that is measured
LAG = 0.03
SCALE_ERROR = 0.05
# of Student's t that innovations have: a position reset or a touch of the ground is no wind
FREEDOM = 8.0
# m/s² across the thrust axis, beyond which the velocity jumped; s to the next data
MAX_FORCE = 25.0
BRIDGED = 10.0
# TOTAL_WIND_MATRIX (2, 4): w + m of the four states
PLANE = np.eye(2)
TOTAL_WIND_MATRIX = np.kron([[1.0, 1.0]], PLANE)


class MotionGrid(NamedTuple):
    """Attitude, velocity and specific force on a grid of ``step`` s; NaN where a step has no samples."""

    time: Array  # (T,) s, of each step's middle
    axes: Array  # (T, 2, 3) body x and y in north, east, down
    velocity: Array  # (T, 3) m/s, relative to the ground, or to the air where that is known
    force: Array  # (T, 2) m/s², along body x and y
    doubt: Array  # (T,) m/s², the force's sd that timing and scale of attitude and velocity make
    step: float

    @property
    def known(self) -> Flags:
        """(T,) which steps have all of it."""
        return np.asarray(
            np.isfinite(self.force).all(axis=1) & np.isfinite(self.velocity).all(axis=1)
        )

    def at(self, rows: Flags | slice) -> MotionGrid:
        """Returns those steps."""
        columns = {name: part[rows] for name, part in self._asdict().items() if name != "step"}
        return MotionGrid(**columns, step=self.step)


def motion_grid(
    time: Array,
    attitude: Array,
    velocity: Array,
    step: float,
    wind: Array | None = None,
) -> MotionGrid:
    """Returns the motion on a grid, all of it in means over two steps that weigh their middle most.

    These means of the acceleration are the difference between each step's means of the ``velocity``: of one kernel,
    manoeuvres do not look like drag. ``time`` (T,) and ``step`` are in s; ``attitude`` (T, 3), roll, pitch and yaw in
    rad, and velocity (T, 3), m/s north, east and down; a known ``wind`` (T, 2), m/s, is taken off the velocity.
    """
    turned = Rotation.from_euler("ZYX", attitude[:, ::-1]).as_matrix()
    x, y, z = np.transpose(turned, (2, 1, 0))
    # body z, by its part downwards
    tilt = z[:2] / z[2]
    air = np.zeros((2, len(time))) if wind is None else wind.T
    start = time[0] - np.median(np.diff(time)) / 2
    count = int((time[-1] - start) / step + 1e-6) + 1
    row = np.minimum(((time - start) / step + 1e-6).astype(int), count - 1)
    share = (time - start) / step - row

    def sums(weights: Array) -> Array:
        columns = np.array([np.ones(len(time)), *x, *y, *tilt, *air, *velocity.T])
        return np.array([np.bincount(row, column, count) for column in weights * columns])

    late = sums(share)
    whole = sums(np.ones(len(time)))
    hats = (whole - late)[:, 1:] + late[:, :-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = (hats / hats[0]).T
        change = np.diff(whole / whole[0]).T / step
    axes = middle[:, 1:7].reshape(-1, 2, 3)
    speed = middle[:, 11:].copy()
    faster = change[:, 11:]
    # Thrust carries the weight, and so much of it pushes to the side.
    level = faster[:, :2] + (GRAVITY - faster[:, 2:]) * middle[:, 7:9]
    force = np.einsum("tij,tj->ti", axes[:, :, :2], level)
    force[~(abs(force) < MAX_FORCE).all(axis=1)] = np.nan
    doubt = np.sqrt(
        ((LAG * GRAVITY * change[:, 7:9]) ** 2 + (SCALE_ERROR * faster[:, :2]) ** 2).sum(axis=1)
    )
    speed[:, :2] -= middle[:, 9:11]
    grid = MotionGrid(start + step * np.arange(1, count), axes, speed, force, doubt, step)
    reach = int(BRIDGED / step)
    return grid.at(
        np.convolve([*grid.known, False], np.ones(2 * reach + 1))[reach : reach + len(force)] > 0
    )


class AirflowFilter:
    """Runs an extended Kalman filter for each of G ``parameters`` side by side, step by step of a grid.

    ``parameters`` (G, 10): those of ``Drag.mean``, and logarithms of the gusts' sd (m/s) and time (s), of the change of
    the mean wind (m/s in 1 s) and of e's sd (m/s²). It is linearized first about the wind that the median force of
    ``start`` stands for.

    Attributes:
        states, spreads: (G, 4) and (G, 4, 4) so far.
        total: (G,) log likelihoods.
        decay: (G, 4) of the states in a step.
    """

    def __init__(self, parameters: Array, start: MotionGrid) -> None:
        self._linear, self._quadratic = coefficients(parameters)
        self._lean = parameters[:, 4:6]
        wind_sd, wind_seconds, walk, noise = np.exp(parameters[:, 6:]).T
        phi = np.exp(-start.step / wind_seconds)
        both = np.ones(len(parameters))
        self.decay = np.repeat(np.stack([phi, both], axis=1), 2, axis=1)
        self.spreads = _diagonal(wind_sd**2, WIND_SD**2 * both)
        self._process = _diagonal(wind_sd**2 * (1 - phi**2), walk**2 * start.step)
        self._fade = self.decay[:, :, None] * self.decay[:, None, :]
        self._noise = (noise**2)[:, None, None] * PLANE
        self.total = np.zeros(len(parameters))
        measured = start.known
        axes = start.axes[measured][:, :, :2]
        force = np.median(np.einsum("tij,ti->tj", axes, start.force[measured]), axis=0)
        size = np.hypot(*force)
        speed = air_speed(self._linear.mean(axis=1), self._quadratic.mean(axis=1), size)
        against = force / max(size, 1e-9) * speed[:, None]
        mean = np.median(start.velocity[measured, :2], axis=0) + against
        self.states = np.hstack([np.zeros_like(mean), mean])

    def predict(self) -> None:
        """Goes on by a step."""
        self.states = self.states * self.decay
        self.spreads = self.spreads * self._fade + self._process

    def update(self, motion: MotionGrid, step: int) -> ArrayPair:
        """Takes what a ``step`` of the motion measured; returns errors (G, 2) and covariances of the predictions."""
        x = self.states
        P = self.spreads
        axes = motion.axes[step]
        u = axes @ motion.velocity[step] - x @ (axes[:, :2] @ TOTAL_WIND_MATRIX).T
        speed = np.sqrt((u * u).sum(axis=1) + 1e-4)[:, None]
        drag = self._linear + self._quadratic * speed
        slope = drag[:, :, None] * PLANE + (self._quadratic / speed * u)[:, :, None] * u[:, None, :]
        A = slope @ axes[:, :2]  # the errors' slope by the wind, gusts and mean alike
        error = motion.force[step] + drag * u - self._lean
        HP = A @ TOTAL_WIND_MATRIX @ P
        S = HP @ TOTAL_WIND_MATRIX.T @ A.mT + self._noise + motion.doubt[step] ** 2 * PLANE
        S = (S + S.mT) / 2  # else rounding grows
        determinant = (S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] ** 2)[:, None, None]
        inverse = (S.trace(axis1=1, axis2=2)[:, None, None] * PLANE - S) / determinant
        row = error[:, None]
        squares = row @ inverse @ error[:, :, None]
        surprise = np.log(determinant) / 2 + (FREEDOM + 2) / 2 * np.log1p(squares / FREEDOM)
        self.total -= surprise[:, 0, 0]
        K = inverse * np.minimum((FREEDOM + 2) / (FREEDOM + squares), 1.0) @ HP
        self.states = x + (row @ K)[:, 0]
        self.spreads = P - K.mT @ HP
        return error, S


def _diagonal(wind: Array, mean: Array) -> Array:
    """(G, 4, 4) covariances with variances (G,) of the gusts' two components and of the mean wind's."""
    return np.repeat(np.stack([wind, mean], axis=1), 2, axis=1)[:, :, None] * np.eye(4)


class Filtered(NamedTuple):
    """What a :class:`AirflowFilter` leaves of T steps, for each of G parameters."""

    log_likelihood: Array  # (G,)
    errors: Array  # (T, G, 2) innovations, m/s², NaN where the motion is not known
    spread: Array  # (T, G, 2, 2) of these
    states: Array  # (2, T, G, 4) before each step's measurement, and after it
    spreads: Array  # (2, T, G, 4, 4) likewise
    decay: Array  # (G, 4) of the states in a step

    def smoothed(self) -> ArrayPair:
        """Returns states (T, G, 4) and covariances given all steps (Rauch, Tung and Striebel, 1965)."""
        x_before, states = self.states
        P_before, spreads = self.spreads
        decayed = (spreads[:-1] * self.decay[:, None, :]).mT
        gains = np.linalg.solve(P_before[1:], decayed).mT
        for t in range(len(states) - 2, -1, -1):
            K = gains[t]
            states[t] += np.einsum("gij,gj->gi", K, states[t + 1] - x_before[t + 1])
            spreads[t] += K @ (spreads[t + 1] - P_before[t + 1]) @ K.mT
        return states, spreads


def filtered(parameters: Array, motion: MotionGrid) -> Filtered:
    """Returns what a ``AirflowFilter`` leaves of the ``motion``."""
    run = AirflowFilter(parameters, motion)
    measured = motion.known
    size = len(motion.force), len(parameters)
    states = np.empty((2, *size, 4))
    spreads = np.empty((2, *size, 4, 4))
    errors = np.full((*size, 2), np.nan)
    expected = np.full((*size, 2, 2), np.nan)
    for t, is_known in enumerate(measured):
        if t:
            run.predict()
        states[:, t] = run.states
        spreads[:, t] = run.spreads
        if is_known:
            errors[t], expected[t] = run.update(motion, t)
            states[1, t] = run.states
            spreads[1, t] = run.spreads
    return Filtered(run.total, errors, expected, states, spreads, run.decay)


def air_speed(linear: Array, quadratic: Array, force: float) -> Array:
    """Returns the air speed, m/s, at which ``linear`` and ``quadratic`` drag makes a ``force``, m/s²."""
    return 2 * force / (linear + np.sqrt(linear**2 + 4 * quadratic * force))
