"""The assessment of a vehicle's flights: which motor works too hard, by how much and how surely, or why not.

docs/motors.md says how it is judged. Beside the balance stands the effort: a rotor's speed goes with its command times
the voltage, so the collective times the voltage stays as the battery sags. More of it is needed for a payload, in
thinner air, and with propellers that give less thrust: which, it does not say.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from mavdem.arrays import Array, ArrayPair
from mavdem.confidence import INTERVAL_QUANTILES
from mavdem.containers import JsonValues
from mavdem.dem.engine.linalg import SMALLEST_POSITIVE
from mavdem.facts import Fact
from mavdem.facts.motors import Explanation, HealthUnknown, MotorHealth, MotorsBetween
from mavdem.immutable import ImmutableResult
from mavdem.motors.balance import (
    FEWEST_FLIGHTS,
    SCATTER_FREEDOM,
    Deviation,
    HealthFigures,
    HealthFlights,
    MotorSignatures,
    deviation,
    healthy_flights,
)

PROBABLE = 0.5
"""Probability of a fault, and of any change, from which a flight is called one."""
NAMED = 0.8  # A motor is named if, given that one is faulty, it is that one with this probability


class HealthAssessment(NamedTuple):
    """What the figures of one flight say of its motors."""

    # fault: a motor works 8 % harder or more than in healthy flights, for it or its propeller is weak; drift: the
    # balance changed, by less or not by a motor, or the effort did; ok: as in healthy flights, and a motor that works
    # 20 % harder would have shown
    health: MotorHealth
    fact: Fact  # what speaks for it, or what is missing
    # that some motor works 8 % harder or more, for it or its propeller is weak; None where unknown
    fault_probability: float | None = None
    # that anything changed, faults included; None where unknown
    change_probability: float | None = None
    suspect_motor: int | None = None  # from 1, of a fault where one is named
    # whether it is one of the healthy flights that the others are judged beside
    is_healthy: bool = False


def assess(
    flights: Sequence[HealthFigures], baseline: Sequence[HealthFigures] | None = None
) -> tuple[HealthAssessment, ...]:
    """Judges each flight of one vehicle against its healthy ones; a healthy one against the other healthy ones.

    Flights with a date are judged in its order, from what is known after those before.

    Args:
        flights: of one vehicle.
        baseline: its healthy flights, of ``flights`` or others; unless given, its first three sound ones by date
            that are no fault beside each other. A flight that was logged twice counts once.
    """
    chosen = baseline is not None
    named = flights if baseline is None else baseline
    healthy = healthy_flights(flights, baseline)
    assessments = {}
    faults = dict[float, HealthFigures]()
    before: dict[object, tuple[Explanations, EffortChange | None]] = {}
    by_time = sorted(enumerate(flights), key=lambda numbered: numbered[1].when)
    for number, flight in by_time:
        apart = [other for other in healthy if other is not flight and not other.overlaps(flight)]
        others = [other for other in apart if other.layout == flight.layout]
        reference: JsonValues = {"flights": len(others), "are_chosen": chosen}
        unknown = flight.missing
        if unknown is None and len(others) < FEWEST_FLIGHTS:
            total = sum(other is not flight for other in named)
            few = HealthUnknown.HEALTHY_FLIGHTS_FEW
            unknown = Fact(few, **reference, total=total, needed=FEWEST_FLIGHTS)
        if unknown is not None:
            assessments[number] = HealthAssessment(MotorHealth.UNKNOWN, unknown)
            continue
        assert flight.signatures is not None
        considered = Candidates(flight.signatures)
        # One of unknown date says nothing of what comes next, and one that was chosen as healthy stands alone.
        alone = flight.date is None or len(apart) < len(healthy)
        last, last_effort = None, None
        if not alone:
            last, last_effort = before.get(flight.layout, (None, None))
        away = deviation(flight, others)
        candidates = None if last is None else last.candidates
        weighed = considered.after(away, candidates)
        effort = effort_change(flight, others, last_effort)
        if not alone:
            before[flight.layout] = weighed, effort
        assessment = _assessment(flight, weighed, away, effort, reference)
        if assessment.health is MotorHealth.FAULT and flight in healthy:
            faults[weighed.fault] = flight
        if assessment.health is MotorHealth.OK and considered.shown(away) < PROBABLE:
            unsure = HealthUnknown.HEALTH_UNSURE
            lost = lost_thrust(DETECTABLE_RISE)
            fact = Fact(unsure, loss=lost, usual=away.usual, **reference)
            assessment = HealthAssessment(MotorHealth.UNKNOWN, fact)
        assessments[number] = assessment
    if faults and not chosen:
        worst = faults[max(faults)]
        return assess(
            [replace(flight, sound=flight.sound and flight is not worst) for flight in flights]
        )
    return tuple(
        assessments[number]._replace(is_healthy=flight in healthy)
        for number, flight in enumerate(flights)
    )


def _assessment(
    flight: HealthFigures,
    weighed: Explanations,
    away: Deviation,
    effort: EffortChange | None,
    reference: JsonValues,
) -> HealthAssessment:
    """The assessment beside the flights of the ``reference``, with what speaks for it."""
    # The effort says nothing of a single motor, and a weak one takes little of it.
    balance = 1 - weighed.healthy
    same_effort = 1.0 if effort is None else 1 - effort.probability
    change = 1 - weighed.healthy * same_effort
    probabilities = weighed.fault, change
    if weighed.fault >= PROBABLE:
        suspect = int(weighed.faults.argmax())
        likely = weighed.faults[suspect]
        is_named = likely >= NAMED * weighed.fault
        rise = weighed.harder[:, suspect]
        weak = Fact(
            MotorsBetween.MOTOR_WEAK,
            subject=flight.motors[suspect] if is_named else "",
            probability=weighed.fault,
            motor_probability=likely,
            rise=rise,
            loss=lost_thrust(rise),
            **reference,
        )
        motor = suspect + 1 if is_named else None
        return HealthAssessment(MotorHealth.FAULT, weak, *probabilities, motor)
    # Whatever the weights of the explanations are, what healthy flights do not show is a change.
    if change < PROBABLE and not away.beyond:
        same = Fact(MotorsBetween.MOTORS_UNCHANGED, probability=change, **reference)
        return HealthAssessment(MotorHealth.OK, same, *probabilities)
    differs = {"shift": away.change, "usual": away.usual, **reference}
    drift = Fact(MotorsBetween.BALANCE_OUTSIDE, **differs)
    if change >= PROBABLE and effort is not None and effort.probability > balance:
        drift = Fact(
            MotorsBetween.EFFORT_CHANGED,
            probability=change,
            balance_probability=balance,
            effort=effort.more,
            **reference,
        )
    elif change >= PROBABLE:
        motor = int(weighed.motors.argmax())
        causes = {**weighed.shares, Explanation.MOTOR: float(weighed.motors[motor])}
        likeliest = max(Explanation, key=lambda cause: causes[cause])
        drift = Fact(
            MotorsBetween.BALANCE_CHANGED,
            subject=flight.motors[motor] if weighed.motors[motor] >= NAMED else "",
            probability=change,
            explanation=likeliest,
            explanation_probability=causes[likeliest],
            rise=weighed.harder[:, motor],
            **differs,
        )
    return HealthAssessment(MotorHealth.DRIFT, drift, *probabilities)


PRIORS = {"healthy": 0.76, "motor": 0.10, "load": 0.08, "yaw": 0.04, "other": 0.02}
"""Before any flight: that nothing changed, that one of the motors or propellers is weak, that roll and pitch, yaw
alone, or all three changed in any way."""
PERSISTENCE = 0.5
"""Probability that what holds in one flight holds in the next: much is seen and put right on the ground."""
MEAN_RISE = 0.15
"""Mean of the exponential prior by how much a weak motor must work harder: what a quarter less thrust takes."""
SHIFT = 0.05
"""Scale of a changed balance on an axis: a load moved by 15 mm on arms of 160 mm, an arm twisted by 1.5°. Changes
follow Student's distribution of ``SHIFT_FREEDOM``, for none is too large to happen."""
SHIFT_FREEDOM = 2.0
FAULT_RISE = 0.08
"""A motor that must work so much harder, for which one of four loses an eighth of its thrust, is a fault."""
DETECTABLE_RISE = 0.2
"""What must show in a flight, or it cannot be called healthy: of four motors, a third less thrust."""
RISES = np.linspace(0.0, 1.0, 401)[1:]
MAX_MISFIT = 4.0  # Scales on any axis from which a deviation is no motor's


Rise = TypeVar("Rise", float, Array)


def lost_thrust(rise: Rise, exponent: float = 2.0) -> Rise:
    """Returns which share of its thrust a motor lost whose command rose so much, to whose ``exponent`` thrust goes."""
    return 1 - (1 + rise) ** -exponent


def shift_sizes(scale: float) -> ArrayPair:
    """Returns standard deviations, and weights with which their normal distributions make Student's of this scale."""
    sizes = scale * np.geomspace(0.4, 40.0, 24)
    decay = np.exp(-SHIFT_FREEDOM / 2 * (scale / sizes) ** 2)
    weights = sizes**-SHIFT_FREEDOM * decay
    return sizes, weights / weights.sum()


class Candidates:
    """All changes of the balance that are considered for a vehicle, with their prior probabilities.

    Attributes:
        signatures: of the vehicle's motors.
        change: (S, 3) of roll, pitch and yaw, in shares of the mean command.
        spread: (S, 3) standard deviation of the change about that.
        prior: (S,), with the sum 1.
        groups: the candidates of each name in ``PRIORS``; those of the motors in the order of motors, then of
            ``RISES``.
    """

    def __init__(self, signatures: MotorSignatures, priors: Mapping[str, float] = PRIORS) -> None:
        """Weighs the groups by ``priors``, of any sum."""
        total = sum(priors.values())
        patterns = signatures.weak_motor[:, None, 1:]
        motors = (patterns * RISES[:, None]).reshape(-1, 3)
        sizes, weights = shift_sizes(SHIFT)
        likely = {
            "healthy": np.ones(1),
            "motor": np.tile(np.exp(-RISES / MEAN_RISE), len(signatures.weak_motor)),
            **dict.fromkeys(("load", "yaw", "other"), weights),
        }
        counts = [len(weights) for weights in likely.values()]
        ends = np.cumsum(counts).tolist()
        self.signatures = signatures
        slices = map(slice, [0, *ends], ends)
        self.groups = dict(zip(likely, slices, strict=True))
        self.prior = np.concatenate(
            [priors[name] / total * weights / weights.sum() for name, weights in likely.items()]
        )
        self.change, self.spread = np.zeros((2, len(self.prior), 3))
        self.change[self.groups["motor"]] = motors
        free_axes = {"load": (1, 1, 0), "yaw": (0, 0, 1), "other": (1, 1, 1)}
        for name, axes in free_axes.items():
            self.spread[self.groups[name]] = np.outer(sizes, axes)

    def after(self, away: Deviation, before: Array | None = None) -> Explanations:
        """Returns what explains a deviation; ``before`` (S,) are the candidates' probabilities after the last."""
        prior = self.prior
        if before is not None:
            prior = PERSISTENCE * before + (1 - PERSISTENCE) * prior
        spread = self.spread.copy()
        shifted = self.groups["load"]
        weak = self.groups["motor"]
        # Yaw by a load that shifted, as far as the flights' effects of lean leave it: wind pulls beside the load.
        spread[shifted, 2] = spread[shifted, 0] * away.lean
        scale = np.hypot(away.scale, spread)
        scales = (away.change - self.change) / scale
        from scipy.stats import t as student  # it takes half a second to import

        densities = student.logpdf(scales, away.freedom) - np.log(scale)
        likelihood = densities.sum(axis=1)
        misfits = (abs(scales[weak]) > MAX_MISFIT).any(axis=1)
        likelihood[weak][misfits] = -np.inf
        posterior = prior * np.exp(likelihood - likelihood.max())
        posterior /= posterior.sum()

        by_name = {name: posterior[rows].sum() for name, rows in self.groups.items()}
        joint = posterior[self.groups["motor"]].reshape(-1, len(RISES))
        motors = joint.sum(axis=1)
        # Of more than four motors the weak one's neighbours help it.
        rise_share = np.diag(self.signatures.weak_motor_commands)
        some = np.maximum(motors, SMALLEST_POSITIVE)
        shares = np.cumsum(joint, axis=1) / some[:, None]
        last = len(RISES) - 1
        low, high = (RISES[(shares < end).sum(axis=1).clip(max=last)] for end in INTERVAL_QUANTILES)
        mean = joint @ RISES / some
        harder = np.array([mean, low, high]) * rise_share
        is_fault = np.outer(rise_share, RISES) >= FAULT_RISE
        faults = np.where(is_fault, joint, 0.0).sum(axis=1)
        return Explanations(by_name, motors, faults, harder, posterior)

    def shown(self, away: Deviation) -> float:
        """Returns a change's probability, on average over the motors, where one had to work ``DETECTABLE_RISE`` harder.

        By the scale of the flight's deviation: what can be seen in it, whatever it shows.
        """
        rises = DETECTABLE_RISE / np.diag(self.signatures.weak_motor_commands)
        weak = self.signatures.weak_motor[:, 1:] * rises[:, None]
        return float(
            np.mean([1 - self.after(away._replace(change=change)).healthy for change in weak])
        )


@dataclass(frozen=True, eq=False)
class Explanations(ImmutableResult):
    """What may explain a flight's deviation, with probabilities that sum to 1."""

    # by the names in ``PRIORS``: that nothing changed but what changes from flight to flight; that a motor or propeller
    # is weak; that roll and pitch changed, as a load shifted; that yaw changed alone; that all three did, not as one
    # motor does
    shares: dict[str, float]
    motors: Array  # (k,) that this motor, or its propeller, is weak
    faults: Array  # (k,) the same, and so weak that the motor must work 8 % harder or more
    # (3, k) by how much each motor must work harder if it is the weak one, as a share of the mean command: the mean,
    # and the ends of the interval of 90 %
    harder: Array
    candidates: Array  # (S,) the probabilities of all candidates

    @property
    def healthy(self) -> float:
        """That nothing changed."""
        return self.shares["healthy"]

    @property
    def fault(self) -> float:
        """That some motor must work 8 % harder or more, for it or its propeller is weak."""
        return self.faults.sum()


EFFORT_SCATTER = 0.02
"""Standard deviation over healthy flights before any was seen, as a share: air of 3 % more or less density, 5 K of
battery temperature, still air or 5 m/s of wind each make 1 to 2 %."""
EFFORT_CHANGED = 0.1  # Probability before any flight that it changed
EFFORT_SHIFT = 0.1  # Scale of a change, as a share


class EffortChange(NamedTuple):
    """The effort of a flight beside that of healthy ones."""

    more: float  # by which share it is greater
    probability: float  # that it changed
    # (S,) the probabilities of no change, then of changes by size
    candidates: Array


def effort_change(
    flight: HealthFigures, healthy: HealthFlights, before: EffortChange | None
) -> EffortChange | None:
    """Returns by how much the effort changed, after what the flight ``before`` showed.

    It is None unless known of three flights.
    """
    efforts = np.log([effort for other in healthy if (effort := other.effort) is not None])
    if flight.effort is None or len(efforts) < FEWEST_FLIGHTS:
        return None
    freedom = SCATTER_FREEDOM + len(efforts) - 1
    centre = efforts.mean()
    spread = ((efforts - centre) ** 2).sum()
    scatter = (SCATTER_FREEDOM * EFFORT_SCATTER**2 + spread) / freedom
    variance = scatter * (1 + 1 / len(efforts))
    more = np.log(flight.effort) - centre
    sizes, weights = shift_sizes(EFFORT_SHIFT)
    prior = np.append(1 - EFFORT_CHANGED, EFFORT_CHANGED * weights)
    if before is not None:
        prior = PERSISTENCE * before.candidates + (1 - PERSISTENCE) * prior
    shifts = np.append(0.0, sizes)
    scale = np.sqrt(variance + shifts**2)
    from scipy.stats import t as student  # it takes half a second to import

    likelihood = student.pdf(more / scale, freedom)
    posterior = prior * likelihood / scale
    posterior /= posterior.sum()
    share = np.expm1(more)
    return EffortChange(share, 1 - posterior[0], posterior)
