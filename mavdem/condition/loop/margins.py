"""Margins of an open loop, and of what its closed loop does, with intervals from draws of the plant's posterior.

An open loop that is estimated from the spectra of a flight's outputs and inputs is biased: wind acts on both. So it is
the identified plant times the known controller. Source of the figures: K. J. Åström and R. M. Murray, Feedback Systems,
2nd ed., secs. 10.3 and 12.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.confidence import LEVEL
from mavdem.dem.engine.linalg import Array

Complex = NDArray[np.complex128]
FIGURES = (
    "crossover",
    "phase_margin",
    "gain_margin",
    "delay_margin",
    "ms",
    "bandwidth",
    "rejection",
)


@dataclass(frozen=True, eq=False, repr=False)
class OpenLoop:
    """One loop, opened at its controller: N responses at F frequencies, the estimate's first and then of draws.

    Figures: ``crossover``, the highest frequency at which the gain is 1, Hz; ``phase_margin``, degrees, negative where
    the loop is unstable; ``gain_margin``, dB, infinite where no frequency has it; ``delay_margin``, s; ``ms``, the
    largest sensitivity; ``bandwidth``, up to which ``closed`` is at least -3 dB, Hz; ``rejection``, the largest of
    ``disturbance``, s or s². Margins are the smallest. Each has a 90 % interval, (low, high): ``ms_interval``.
    """

    frequency: Array  # (F,) Hz
    response: Complex  # (N, F) of the open loop, without its sign
    closed: Complex  # (N, F) from the setpoint to the rate, or the angle
    # (N, F) from the wind's torque, rad/s², to the rate, rad/s, or the angle, rad
    disturbance: Complex
    stable: NDArray[np.bool_]  # (N,) whether the closed loop is
    figures: Mapping[str, Array]  # (N,) of each of ``FIGURES``, by name

    @classmethod
    def of(
        cls, frequency: Array, response: Complex, closed: Complex, disturbance: Complex
    ) -> OpenLoop:
        """Returns the loop with its figures."""
        found = figures(frequency, response, closed, disturbance)
        return cls(frequency, response, closed, disturbance, _stable(response), found)

    def __getattr__(self, name: str) -> Any:
        figure = name.removesuffix("_interval")
        if figure not in FIGURES:
            raise AttributeError(f"an OpenLoop has no attribute {name!r}")
        ends = [0.5 - LEVEL / 2, 0.5 + LEVEL / 2]
        values = self.figures[figure]
        return (
            float(values[0])
            if name == figure
            else tuple(np.quantile(values, ends, method="nearest").tolist())
        )

    def as_dict(self) -> dict[str, Any]:
        """Returns figures and intervals as plain JSON values, None for what is not finite."""
        names = [name for figure in FIGURES for name in (figure, f"{figure}_interval")]
        values = {
            name: [one if np.isfinite(one) else None for one in np.ravel(getattr(self, name))]
            for name in names
        }
        return {name: each if len(each) > 1 else each[0] for name, each in values.items()}


def figures(
    frequency: Array, response: Complex, closed: Complex, disturbance: Complex
) -> dict[str, Array]:
    """Returns (N,) of each of :data:`FIGURES`, of responses (N, F) as in :class:`OpenLoop`."""
    at = np.log(frequency)
    gain = np.log(np.abs(response))
    where, crossing = _crossings(at, gain)
    phase = np.unwrap(np.angle(-response), axis=1)
    margin = (_between(phase, where, crossing) + np.pi) % (2 * np.pi) - np.pi
    hertz = np.exp(at[:-1] + crossing * np.diff(at))
    turned, turning = _crossings(at, response.imag)
    turned &= response.real[:, :-1] < 0
    left = np.where(turned, -_between(gain, turned, turning), np.inf)
    falls, falling = _crossings(at, np.abs(closed) - 2**-0.5)  # half of the power
    first = np.argmax(falls, axis=1)
    rows = np.arange(len(response))
    smallest = np.where(where, margin, np.inf)
    return {
        "crossover": np.where(where.any(axis=1), np.where(where, hertz, 0.0).max(axis=1), np.nan),
        "phase_margin": np.degrees(smallest.min(axis=1)),
        "gain_margin": 20 / np.log(10) * left[rows, np.argmin(np.abs(left), axis=1)],
        "delay_margin": (smallest / (2 * np.pi * hertz)).min(axis=1),
        "ms": np.abs(1 / (1 + response)).max(axis=1),
        "bandwidth": np.where(
            falls.any(axis=1), np.exp(at[first] + falling[rows, first] * np.diff(at)[first]), np.nan
        ),
        "rejection": np.abs(disturbance).max(axis=1),
    }


def _crossings(at: Array, values: Array) -> tuple[NDArray[np.bool_], Array]:
    """(N, F − 1) between which frequencies ``values`` (N, F) change sign, and at which share of the way."""
    before = values[:, :-1]
    after = values[:, 1:]
    changes = np.signbit(before) != np.signbit(after)
    return changes, np.where(changes, before / np.where(changes, before - after, 1.0), 0.0)


def _between(values: Array, where: NDArray[np.bool_], share: Array) -> Array:
    return np.where(where, values[:, :-1] + share * np.diff(values, axis=1), 0.0)


def _stable(response: Complex) -> NDArray[np.bool_]:
    """(N,) whether closed loops are stable, whose open loops are so but for poles at 0 (Nyquist's criterion).

    1 + L turns by a quarter for each pole at 0 from the lowest frequency to the highest, and not at all besides.
    """
    turned = np.unwrap(np.angle(1 + response), axis=1)
    poles = np.round(-np.angle(response[:, 0]) / (np.pi / 2)).clip(0, 2)
    return np.asarray(np.abs(turned[:, -1] - turned[:, 0] - poles * np.pi / 2) < np.pi)
