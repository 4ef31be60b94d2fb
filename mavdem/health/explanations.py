"""Explanations of a changed balance, weighed by Bayes' rule: nothing, one weak motor, a shifted load, yaw, anything.

What changed stays changed for some flights: what is probable after one flight is so before the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from mavdem.health.motor_signature import MotorSignatures
from mavdem.health.reference import Deviation

Array = NDArray[np.float64]

PRIORS = {"healthy": 0.76, "motor": 0.10, "load": 0.08, "yaw": 0.04, "other": 0.02}
"""Before any flight: that nothing changed, that one of the motors or propellers is weak, that roll and pitch, yaw
alone, or all three changed in any way."""
LASTS = 0.5  # Probability that what holds in one flight holds in the next: much is seen and put right on the ground
HARDER = 0.15
"""Mean of the exponential prior by how much a weak motor must work harder: what a quarter less thrust takes."""
SHIFT = 0.05
"""Standard deviation of a changed balance on an axis: a load moved by 15 mm on arms of 160 mm, an arm twisted by
1.5°."""
FAULTY = 0.08  # A motor that must work so much harder, for which it loses an eighth of its thrust, is a fault
RISES = np.linspace(0.0, 1.0, 401)[1:]
SHIFTS = np.linspace(-4 * SHIFT, 4 * SHIFT, 81)
SAMPLES = 4000  # Of changes of all axes, drawn once and for all
CENTRES = 7  # Nodes on each axis for the error of the healthy flights' mean
TAIL = 0.05  # Outside each end of an interval of 90 %


class Candidates:
    """All changes of the balance that are considered for a vehicle, with their prior probabilities.

    Attributes:
        signatures: of the vehicle's motors.
        change: (S, 3) of roll, pitch and yaw, in shares of the mean command.
        centre: (S, 3) error of the healthy flights' mean, in its standard errors: of the candidates without a change.
        prior: (S,), with the sum 1.
        groups: the candidates of each name in ``PRIORS``; those of the motors in the order of motors, then of
            ``RISES``.
    """

    def __init__(self, signatures: MotorSignatures) -> None:
        nodes, weights = np.polynomial.hermite_e.hermegauss(CENTRES)
        spread = stats.norm.pdf(SHIFTS, scale=SHIFT)
        rises = np.exp(-RISES / HARDER)
        flat = [(roll, pitch, 0.0) for roll, pitch in product(SHIFTS, SHIFTS)]
        changes = {
            "healthy": np.zeros((CENTRES**3, 3)),
            "motor": (signatures.weak_motor[:, None, 1:] * RISES[:, None]).reshape(-1, 3),
            "load": np.array(flat),
            "yaw": SHIFTS[:, None] * np.array([0.0, 0.0, 1.0]),
            "other": np.random.default_rng(0).normal(scale=SHIFT, size=(SAMPLES, 3)),
        }
        likely = {
            "healthy": np.prod(list(product(weights, repeat=3)), axis=1),
            "motor": np.tile(rises, len(signatures.weak_motor)),
            "load": np.outer(spread, spread).ravel(),
            "yaw": spread,
            "other": np.ones(SAMPLES),
        }
        self.signatures = signatures
        self.change = np.concatenate(list(changes.values()))
        self.prior = np.concatenate([PRIORS[name] * each / each.sum() for name, each in likely.items()])
        ends = np.cumsum([len(each) for each in changes.values()])
        self.groups = {
            name: slice(int(end) - len(each), int(end)) for (name, each), end in zip(changes.items(), ends, strict=True)
        }
        self.centre = np.zeros_like(self.change)
        self.centre[self.groups["healthy"]] = list(product(nodes, repeat=3))

    def after(self, found: Deviation, before: Array | None = None) -> Explanations:
        """What explains a flight's deviation; ``before`` (S,) are the candidates' probabilities after the last."""
        prior = self.prior if before is None else LASTS * before + (1 - LASTS) * self.prior
        # The candidates without a change carry the common error of the mean themselves, and so share it over flights.
        own = np.ones(len(prior), dtype=bool)
        own[self.groups["healthy"]] = False
        scale = np.sqrt(found.scale**2 + own[:, None] * found.centre_error**2)
        away = (found.change - self.change - self.centre * found.centre_error) / scale
        likelihood = (stats.t.logpdf(away, found.freedom) - np.log(scale)).sum(axis=1)
        posterior = prior * np.exp(likelihood - likelihood.max())
        return self._summed(posterior / posterior.sum())

    def _summed(self, posterior: Array) -> Explanations:
        each = {name: float(posterior[rows].sum()) for name, rows in self.groups.items()}
        joint = posterior[self.groups["motor"]].reshape(-1, len(RISES))
        motors = joint.sum(axis=1)
        # Of more than four motors the weak one's neighbours help it.
        own = np.diag(self.signatures.weak_motor_commands)
        shares = np.cumsum(joint, axis=1) / motors[:, None]
        low, high = (RISES[(shares < end).sum(axis=1).clip(max=len(RISES) - 1)] for end in (TAIL, 1 - TAIL))
        harder = np.array([joint @ RISES / motors, low, high]) * own
        faults = np.where(np.outer(own, RISES) >= FAULTY, joint, 0.0).sum(axis=1)
        return Explanations(
            each["healthy"], motors, faults, each["load"], each["yaw"], each["other"], harder, posterior
        )


@dataclass(frozen=True, eq=False)
class Explanations:
    """What may explain a flight's deviation, with probabilities that sum to 1.

    Attributes:
        healthy: nothing changed but what changes from flight to flight.
        motors: (k,) that this motor, or its propeller, is weak.
        faults: (k,) the same, and so weak that the motor must work 8 % harder or more.
        load: that roll and pitch changed: a load shifted.
        yaw: that yaw changed alone: an arm or motor twisted, or other propellers.
        other: that all three changed, not as one motor does.
        harder: (3, k) by how much each motor must work harder if it is the weak one, as a share of the mean command:
            the mean, and the ends of the interval of 90 %.
        candidates: (S,) the probabilities of all candidates.
    """

    healthy: float
    motors: Array
    faults: Array
    load: float
    yaw: float
    other: float
    harder: Array
    candidates: Array

    @property
    def fault(self) -> float:
        """That any motor must work 8 % harder or more."""
        return float(self.faults.sum())

    @property
    def motor(self) -> float:
        """That any motor or propeller is weak."""
        return float(self.motors.sum())

    @property
    def suspect(self) -> int:
        """Which motor is the likeliest to be weak, from 1."""
        return int(self.motors.argmax()) + 1
