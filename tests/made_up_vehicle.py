"""A made-up vehicle whose flights differ as healthy ones do, or by a weak motor, a shifted load, or yaw."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np

from mavdem.health.balance import BalanceFigures, motor_signatures
from mavdem.health.reference import HealthFigures

MOTORS = ("motor 1 (front right)", "motor 2 (rear left)", "motor 3 (front left)", "motor 4 (rear right)")
QUAD_X = motor_signatures(4, [(1, 1), (-1, -1), (1, -1), (-1, 1)], [1, 1, -1, -1])
OFFSET = np.array([0.01, -0.02, 0.005])
LEAN_EFFECT = np.array([[0.9, 0.1], [-0.1, 0.8], [0.3, -0.2]])
ERROR, EFFECT_ERROR = 0.003, 0.15
FIRST = datetime(2026, 3, 1, tzinfo=UTC)


class MadeUpVehicle:
    """Flights differ by ``scatter`` in the balance on each axis, and lean by 3° and more in the wind of their day."""

    def __init__(self, seed: int, scatter: float = 0.008, motors: tuple[str, ...] = MOTORS) -> None:
        self.rng = np.random.default_rng(seed)
        self.scatter = scatter
        self.motors = motors
        self.flown = 0

    def flight(self, change: np.ndarray | None = None) -> HealthFigures:
        """One of a vehicle whose balance changed by ``change`` (3,) from when it was healthy."""
        rng = self.rng
        lean = rng.normal(scale=0.05, size=2)
        mean = OFFSET + rng.normal(scale=self.scatter, size=3) + (0.0 if change is None else change)
        mean += LEAN_EFFECT @ lean
        effect = LEAN_EFFECT + rng.normal(scale=EFFECT_ERROR, size=(3, 2))
        balance = BalanceFigures(mean, np.full(3, ERROR), lean, effect, np.full((3, 2), EFFECT_ERROR), 60.0)
        self.flown += 1
        when = FIRST + timedelta(days=self.flown)
        return HealthFigures(f"flight {self.flown}", self.motors, QUAD_X, balance, when, 0.5, 11.0)

    def flights(self, count: int, change: np.ndarray | None = None) -> list[HealthFigures]:
        return [self.flight(change) for _ in range(count)]


def weak(motor: int, harder: float) -> np.ndarray:
    """The change of the balance where ``motor``, from 1, must work ``harder``."""
    return harder * QUAD_X.weak_motor[motor - 1, 1:]


def undated(flights: list[HealthFigures]) -> list[HealthFigures]:
    return [replace(flight, date=None) for flight in flights]
