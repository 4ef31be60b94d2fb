"""Drag of a multirotor along its two body axes: the model, what is known of it beforehand, and autopilots' parameters.

The specific force across the thrust axis is −(c + q |u|) u along body x and y, of the velocity u relative to the air,
and a constant lean. The linear part c is the rotors' momentum drag, the quadratic part q the body's (Martin and Salaün,
ICRA 2010; ``drag_fusion.cpp`` of PX4's EKF2, ``AP_NavEKF3_AirDataFusion.cpp`` of ArduPilot).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from mavdem.confidence import quantile
from mavdem.dem.engine.linalg import Array

POPULATION, POPULATION_SD = np.log([0.3, 0.014, 1.0, 1.0]), np.array([0.7, 0.9, 0.2, 0.35])
"""Logarithms of linear drag (1/s), quadratic drag (1/m) and the ratio of body y to x of each: of 9 vehicles, 3 real,
whose linear drag is 0.15 to 0.6; PX4's simulator SIH has 1."""
LEAN_SD, LEAN_CHANGE = 0.18, 0.1
"""m/s² of lean that no wind makes: 1° of misaligned attitude or shifted load, and of it what one flight only has, as a
Solo beside an anemometer. PX4's simulator draws 0.05 to 0.4 m/s² of accelerometer bias a flight."""
HALF_AIR_DENSITY = 1.225 / 2  # kg/m³ at sea level, by which both autopilots define a ballistic coefficient
SET_SD = 0.3  # of the logarithm of a coefficient that somebody set in the autopilot: few are calibrated
PARAMETERS = {"ARDUPILOTMEGA": ("EK3_DRAG_MCOEF", "EK3_DRAG_BCOEF_"), "PX4": ("EKF2_MCOEF", "EKF2_BCOEF_")}
"""Of momentum drag, 1/s at sea level, and of the ballistic coefficient along X and Y, kg/m²: 0.5 ρ / q."""
DEFAULTS = {"EKF2_MCOEF": (0.15,), "EKF2_BCOEF_X": (25.0, 100.0), "EKF2_BCOEF_Y": (25.0, 100.0)}
"""PX4 has these unless somebody sets others; ArduPilot has 0, which switches the model off."""
AXES = np.array([-0.5, 0.5])


def coefficients(logs: Array) -> tuple[Array, Array]:
    """Returns linear (…, 2) 1/s and quadratic (…, 2) 1/m drag along body x and y, of ``logs`` (…, 4 or more)."""
    c, q, c_ratio, q_ratio = (logs[..., [k]] for k in range(4))
    return np.exp(c + c_ratio * AXES), np.exp(q + q_ratio * AXES)


SOURCES = {
    "population": "other vehicles",
    "parameters": "the autopilot's parameters",
    "flight": "flight",
    "calibration": "calibration",
}


@dataclass(frozen=True, eq=False)
class Drag:
    """Drag of one vehicle, per mass, with its uncertainty.

    Attributes:
        mean: (6,) of ln c and ln q, geometric over both axes, of ln c_y/c_x and ln q_y/q_x, and of :attr:`lean`.
        covariance: (6, 6) of these.
        source: a key of ``SOURCES``.
    """

    mean: Array
    covariance: Array
    source: str = "population"

    @classmethod
    def of_parameters(cls, autopilot: str = "", parameters: Mapping[str, float] = MappingProxyType({})) -> Drag:
        """Returns the population's drag, and what the ``autopilot``'s own ``parameters`` say where they were set."""
        momentum, ballistic = PARAMETERS.get(autopilot, ("", ""))
        names = momentum, f"{ballistic}X", f"{ballistic}Y"
        changed = {name: value for name, value in parameters.items() if round(value, 6) not in DEFAULTS.get(name, ())}
        m, x, y = (changed.get(name, 0.0) for name in names)
        logs, sd, source = POPULATION.copy(), POPULATION_SD.copy(), "population"
        if m > 0.001:  # below, EKF2 takes the part for switched off
            logs[0], sd[0], source = np.log(m), SET_SD, "parameters"
        if x > 1 and y > 1:
            logs[[1, 3]], sd[[1, 3]] = np.log([HALF_AIR_DENSITY / np.sqrt(x * y), x / y]), SET_SD
            source = "parameters"
        return cls(np.append(logs, [0.0, 0.0]), np.diag(np.append(sd, [LEAN_SD, LEAN_SD]) ** 2), source)

    linear = property(lambda self: coefficients(self.mean)[0], doc="Linear drag (2,) along body x and y, 1/s: medians.")
    quadratic = property(lambda self: coefficients(self.mean)[1], doc="Likewise the quadratic drag (2,), 1/m.")
    lean = property(lambda self: self.mean[4:], doc="Specific force (2,) along body x and y that no wind makes, m/s².")

    def interval(self, name: str) -> Array:
        """Returns (2, 2) lower and upper ends, by axis, of the 90 % interval of ``name``: linear or quadratic."""
        read = np.zeros((2, 6))
        read[:, [0, 2] if name == "linear" else [1, 3]] = np.column_stack([np.ones(2), AXES])
        half = quantile() * np.sqrt(np.diag(read @ self.covariance @ read.T))
        return np.asarray(getattr(self, name) * np.exp(np.outer([-1, 1], half)))

    def relative_sd(self, speed: float) -> float:
        """Returns the relative standard deviation of the drag at an air ``speed``, m/s."""
        parts = np.exp(self.mean[:2]) * [1.0, speed]
        return float(np.sqrt(parts @ self.covariance[:2, :2] @ parts) / parts.sum())

    def parameters(self, autopilot: str) -> dict[str, tuple[float, float, float]]:
        """Returns the ``autopilot``'s parameters to set, with both ends of 90 % intervals; empty without any."""
        if autopilot not in PARAMETERS:
            return {}
        momentum, ballistic = PARAMETERS[autopilot]
        (low, high), q, ends = self.interval("linear").mean(axis=1), self.quadratic, self.interval("quadratic")
        found = {momentum: (float(np.exp(self.mean[0])), float(low), float(high))}
        bodies = HALF_AIR_DENSITY / np.array([q, ends[1], ends[0]]).T
        return found | {ballistic + axis: tuple(body.tolist()) for axis, body in zip("XY", bodies, strict=True)}

    def of_next_flight(self) -> Drag:
        """Returns what is known before another flight of the vehicle: a part of its lean is that of this one only."""
        kept = 1 - (LEAN_CHANGE / LEAN_SD) ** 2
        scale = np.array([1, 1, 1, 1, kept, kept])
        change = np.diag([0, 0, 0, 0, 1, 1]) * LEAN_SD**2 * (1 - kept**2)
        return Drag(self.mean * scale, self.covariance * np.outer(scale, scale) + change, self.source)

    def as_dict(self) -> dict[str, Any]:
        """Returns plain JSON values, which :meth:`from_dict` reads."""
        names = ("linear", "quadratic")
        shown = {name: getattr(self, name).tolist() for name in (*names, "mean", "covariance")}
        return shown | {f"{name}_interval": self.interval(name).tolist() for name in names} | {"source": self.source}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Drag:
        """Returns the drag whose ``values`` :meth:`as_dict` made; ``ValueError`` or ``KeyError`` for others."""
        mean, covariance = (np.array(values[name], np.float64) for name in ("mean", "covariance"))
        if not np.linalg.eigvalsh(covariance.reshape(6, 6))[0] > 0:  # nor where it is not finite
            raise ValueError("its covariance is none")
        return cls(mean.reshape(6), covariance.reshape(6, 6), str(values["source"]))

    @classmethod
    def of_axes(cls, values: Sequence[float], halves: Sequence[float]) -> Drag:
        """Returns the drag of ``values``, linear (1/s) then quadratic (1/m) along x and y, ± their ``halves``."""
        logs, sd = np.log(values).reshape(2, 2), (np.arcsinh(np.divide(halves, values)) / quantile()).reshape(2, 2)
        mean = [*logs.mean(axis=1), *np.diff(logs).ravel(), 0.0, 0.0]
        return cls(np.array(mean), np.diag([*sd.mean(axis=1), *POPULATION_SD[2:], LEAN_SD, LEAN_SD]) ** 2, "flight")
