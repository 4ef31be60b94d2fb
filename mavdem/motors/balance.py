"""Balance: what a settled flight asks of its motors in roll, pitch and yaw, and how that follows the vehicle's lean.

docs/motors.md says how it is judged. Wind that a vehicle leans against asks for a steady torque too: by the flapping of
its rotors, by drag above or below its centre of mass, by a load beside it.

With six or eight motors the mixer commands thrust, roll, pitch and yaw only, so a weak motor raises its neighbours
too: commands change by the motor's projection on what the mixer can command.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, ArrayPair
from mavdem.confidence import coverage_factor
from mavdem.containers import Names
from mavdem.dataset.axes import AXES
from mavdem.dataset.intervals import intersection, total_duration
from mavdem.dataset.segments import Segment, in_segments, settled_segments
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import steady_intervals
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.facts import Fact
from mavdem.facts.motors import HealthUnknown
from mavdem.ingest.motors import MotorGeometry

BLOCK_SECONDS = 3.0
"""Over which commands and lean are averaged: longer than the attitude's motion, shorter than most gusts."""
FEWEST_BLOCKS = 6  # From which means and slopes have an error that can be estimated
LEAST_SECONDS = 10.0
"""Of steady flight without which no motor is named: of 324 real logs, shorter ones showed gusts and corrections."""


@dataclass(frozen=True)
class MotorSignatures:
    """The patterns of a vehicle with k motors, over the a axes that its layout is known for."""

    # "thrust", then "roll" and "pitch" where the motors' places are known, "yaw" where their spins are
    axes: Names
    # (a, k) from commands to axes: thrust is the mean of all motors, roll on an X quad (left - right)/4, as
    # ``MotorGeometry.effect`` has them
    weights: Array

    @property
    def weak_motor(self) -> Array:
        """(k, a) how the balance of commands changes where motor i, by row, must work harder by 1."""
        return self.weights.T

    @cached_property
    def weak_motor_commands(self) -> Array:
        """(k, k) the same as commands of all motors: of four motors the identity, of more also the neighbours'."""
        inverse = np.linalg.pinv(self.weights)
        return (inverse @ self.weights).T

    @cached_property
    def names_a_motor(self) -> bool:
        """Whether a weak motor can be told from a shifted load and from another weak motor.

        Without spins it cannot: every motor's signature is then that of a load shifted towards it. Nor can it where two
        motors lie above each other and turn the same way.
        """
        signatures = self.weak_motor[:, 1:]
        if len(self.axes) <= len(AXES) or not signatures[:, -1].all():
            return False
        length = np.linalg.norm(signatures, axis=1, keepdims=True)
        unit = signatures / length
        likeness = np.triu(unit @ unit.T, 1)
        return likeness.max() < 0.99


def motor_signatures(layout: MotorGeometry) -> MotorSignatures:
    """Returns those of a vehicle whose motors are as the ``layout`` has them."""
    motors = len(layout.motors)
    effects = {axis: effect for axis in AXES if (effect := layout.mixer_row(axis)) is not None}
    thrust = np.full(motors, 1.0 / motors)
    weights = np.array([thrust, *effects.values()])
    return MotorSignatures(("thrust", *effects), weights)


class BalanceFigures(NamedTuple):
    """The balance of one vehicle in settled flight, in shares of the mean command of all motors.

    NaN stands for what the layout of the motors or the log does not say. Errors are standard errors.
    """

    mean: Array  # (3,) of roll, pitch and yaw
    error: Array  # (3,) of ``mean`` at this lean, by the scatter of blocks of 3 s or a little more
    lean: Array  # (2,) mean roll and pitch, rad
    lean_effect: Array  # (3, 2) change of the balance by roll and by pitch, 1/rad
    lean_effect_error: Array  # (3, 2)
    seconds: float  # of settled flight


@cached_per_vehicle("axis", "inputs")
def balance_of_signals(signals: Signals) -> BalanceFigures | None:
    """Returns the figures of a vehicle's steady flight; None without motor outputs, or where it is too short."""
    motors = signals.motors
    if motors is None:
        return None
    signatures = motor_signatures(motors.geometry)
    runs = []
    seconds = 0.0
    for segment in sorted(settled_segments(signals)):
        spans = intersection(
            [(segment.start, segment.end)], steady_intervals(signals, segment.boot)
        )
        seconds += total_duration(spans)
        parts = (Segment(segment.boot, *span) for span in spans)
        here = in_segments(motors, *parts)
        time = motors.time[here]
        lean = np.full((len(time), 2), np.nan)
        for column, tilt in enumerate(signals.tilts if len(signals.tilts) == 2 else ()):
            rows = in_segments(tilt, segment)
            if rows.any():
                lean[:, column] = np.interp(time, tilt.time[rows], tilt.angle[rows])
        commands = motors.scale.fraction(motors.outputs[here])
        runs.append((time, commands, lean))
    return balance_figures(runs, signatures, seconds)


def balance_figures(
    runs: Sequence[tuple[Array, Array, Array]], signatures: MotorSignatures, seconds: float
) -> BalanceFigures | None:
    """Returns those of unbroken runs of samples, of so many ``seconds`` in all; None where they are too short.

    A run is time (N,), s, rising; the motors' commands (N, k) as shares of their range; roll and pitch (N, 2), rad, NaN
    where not known.
    """
    blocks = [block for run in runs for block in _blocks(*run, signatures)]
    if len(blocks) < FEWEST_BLOCKS or len(signatures.axes) == 1:
        return None
    balance, lean = np.split(np.array(blocks), [3], axis=1)
    rest = balance - balance.mean(axis=0)
    leaned = lean - lean.mean(axis=0)
    effect, effect_variance = np.full((2, 3, 2), np.nan)
    freedom = len(blocks) - 1
    if np.isfinite(leaned).all() and np.linalg.matrix_rank(leaned) == 2:
        inverse = np.linalg.inv(leaned.T @ leaned)
        effect = (inverse @ leaned.T @ rest).T
        rest = rest - leaned @ effect.T
        freedom -= 2
        effect_variance = np.broadcast_to(np.diag(inverse), (3, 2))
    inflation = [_inflation(column) for column in rest.T]
    own_variance = (rest**2).sum(axis=0) / freedom
    variance = own_variance * inflation
    error = np.sqrt(variance / len(blocks))
    effect_error = np.sqrt(variance[:, None] * effect_variance)
    return BalanceFigures(
        balance.mean(axis=0), error, lean.mean(axis=0), effect, effect_error, seconds
    )


def _blocks(time: Array, commands: Array, lean: Array, signatures: MotorSignatures) -> list[Array]:
    """(5,) means of the balance, over that of all motors, and of the lean, of each block of equal length."""
    seconds = float(np.ptp(time)) if len(time) else 0.0
    if seconds < BLOCK_SECONDS:
        return []
    balance = np.full((len(time), 3), np.nan)
    asked = commands @ signatures.weights.T
    columns = [AXES.index(axis) for axis in signatures.axes[1:]]
    balance[:, columns] = asked[:, 1:]
    table = np.column_stack([asked[:, 0], balance, lean])
    count = int(seconds / BLOCK_SECONDS)
    passed = (time - time[0]) / seconds
    number = np.minimum(passed * count, count - 1).astype(int)
    means = [table[number == block].mean(axis=0) for block in np.unique(number)]
    flown = [mean for mean in means if mean[0] > 0]
    return [np.append(mean[1:4] / mean[0], mean[4:]) for mean in flown]


def _inflation(rest: Array) -> float:
    """By how much the variance of a mean exceeds that of independent blocks, as for a first-order autoregression."""
    power = float(rest @ rest)
    correlation = float(rest[1:] @ rest[:-1]) / power if power > 0 else 0.0
    correlation = min(max(correlation, 0.0), 0.9)
    return (1 + correlation) / (1 - correlation)


FEWEST_FLIGHTS = 2  # Of healthy ones: one alone does not show how much they differ

SCATTER = np.array([0.010, 0.010, 0.008])
"""Standard deviation of the level balance over healthy flights, before any was seen, in shares of the mean command. A
battery 3 mm off on arms of 160 mm shifts 2 % of the thrust from one side to the other; commands go with its root or a
little more slowly. An arm twisted by 1° gives about 3 % in yaw, and a quarter of that is taken for usual."""
SCATTER_FREEDOM = 6.0  # So many healthy flights that knowledge is worth

LEAN_EFFECT = np.array([[1.0, 0.3], [0.3, 1.0], [0.3, 0.3]])
"""Standard deviation of the effects of lean, 1/rad, before any flight: drag an arm's length above or below the centre
of mass in roll and pitch; in yaw, and across, a load 5 mm beside it."""
LEAN_EFFECT_SCATTER = 0.2
LEAN_EFFECT_FREEDOM = 1.0
"""Standard deviation of the same over flights of one vehicle, 1/rad, before any flight, and how many flights that is
worth: loads differ, and where a vehicle manoeuvres it also leans without wind."""


@dataclass(frozen=True, eq=False)
class HealthFigures:
    """One flight of a vehicle, as far as its health is judged by it."""

    name: str  # of the flight
    motors: Names = ()  # names of the motors
    signatures: MotorSignatures | None = None  # of the motors; None where the motors are not known
    balance: BalanceFigures | None = None  # None where it was too short or the log holds none
    date: datetime | None = None  # when it began
    collective: float | None = None  # mean command of all motors, as a share of the range
    voltage: float | None = None  # mean of the battery, V
    # no motor was at its limit, it did not oscillate, and it is no fault: it may be taken for healthy
    sound: bool = True

    @property
    def missing(self) -> Fact | None:
        """What the judgement of a motor needs and the flight does not have; None if it has all."""
        if self.signatures is None or self.balance is None:
            return Fact(HealthUnknown.BALANCE_UNKNOWN)
        if not self.signatures.names_a_motor:
            return Fact(HealthUnknown.GEOMETRY_UNKNOWN)
        if not all(np.isfinite(values).all() for values in self.balance[:3]):
            return Fact(HealthUnknown.LEAN_UNKNOWN)
        return None

    @property
    def layout(self) -> tuple[Names, bytes]:
        """The motors' names, places and spins: only flights that agree in them have comparable balances."""
        if self.signatures is None:
            return self.motors, b""
        return self.motors, self.signatures.weights.round(6).tobytes()

    def overlaps(self, other: HealthFigures) -> bool:
        """Returns whether both are one flight, logged twice.

        A vehicle that began to fly has not landed as the other begins.
        """
        first, second = sorted((self, other), key=lambda flight: flight.when)
        lasted = 0.0 if first.balance is None else first.balance.seconds
        return second.when - first.when < lasted

    @property
    def when(self) -> float:
        """By which flights are sorted: UNIX s, those without a date last."""
        if self.date is None:
            return np.inf
        return self.date.timestamp()

    @property
    def effort(self) -> float | None:
        """The collective at a battery of 1 V: it grows with the payload, and not as the battery sags."""
        if self.collective and self.voltage:
            return self.collective * self.voltage
        return None


HealthFlights = Sequence[HealthFigures]  # Of one vehicle


class Deviation(NamedTuple):
    """How far a flight's level balance is from that of healthy flights."""

    change: Array  # (3,) in roll, pitch and yaw, in shares of the mean command
    # (3,) by which that of a healthy flight is Student-distributed about the mean of the others
    scale: Array
    freedom: float  # degrees of freedom of that
    lean: float = 0.0  # of the flight, from level, rad

    @property
    def usual(self) -> Array:
        """(3,) half widths of the interval of 90 % of healthy flights' deviations."""
        return coverage_factor() * self.scale

    @property
    def beyond(self) -> bool:
        """Whether it is farther off on some axis than 999 healthy flights in 1000 are."""
        widest = coverage_factor(0.999, self.freedom) * self.scale
        return (abs(self.change) > widest).any()


def healthy_flights(flights: HealthFlights, baseline: HealthFlights | None = None) -> HealthFlights:
    """Returns those to compare with: of the ``baseline``, or else the first three sound dated ones of each layout."""
    if baseline is not None:
        return distinct_flights([flight for flight in baseline if not flight.missing])
    usable = [
        flight
        for flight in flights
        if flight.sound and flight.date is not None and not flight.missing
    ]
    dated = distinct_flights(usable)
    first: dict[object, list[HealthFigures]] = {}
    for flight in sorted(dated, key=lambda flight: flight.when):
        first.setdefault(flight.layout, []).append(flight)
    return tuple(flight for same in first.values() for flight in same[:3])


def distinct_flights(flights: HealthFlights) -> list[HealthFigures]:
    """Returns each flight once, though it was logged twice, as on board and on the ground: with the surer balance."""
    kept: list[HealthFigures] = []
    by_error = sorted(flights, key=_error)
    for flight in by_error:
        if not any(flight.overlaps(other) for other in kept):
            kept.append(flight)
    return [flight for flight in flights if flight in kept]


def _error(flight: HealthFigures) -> float:
    return float(np.linalg.norm(known_balance(flight).error))


def deviation(flight: HealthFigures, healthy: HealthFlights) -> Deviation:
    """Returns how far a flight is from ``healthy`` ones, of which it is none.

    All have what :attr:`HealthFigures.missing` asks. The flights are compared level, by the effect of lean that they
    show themselves. What is left follows Student's distribution, by the healthy flights' scatter and its prior; to its
    scale come the errors of the effects of lean and of the flight's own mean.
    """
    balances = [known_balance(other) for other in (flight, *healthy)]
    level, error = level_balances(balances)
    lean = float(np.linalg.norm(balances[0].lean))
    centre = level[1:].mean(axis=0)
    count = len(healthy)
    freedom = SCATTER_FREEDOM + count - 1
    spread = ((level[1:] - centre) ** 2).sum(axis=0)
    scatter = (SCATTER_FREEDOM * SCATTER**2 + spread) / freedom
    healthy_variance = scatter + error[1:].mean(axis=0)
    scale = np.sqrt(scatter + error[0] + healthy_variance / count)
    return Deviation(level[0] - centre, scale, freedom, lean)


def level_balances(flights: Sequence[BalanceFigures]) -> ArrayPair:
    """Returns (f, 3) the balances without what the lean explains, and the variances of their errors."""
    effect, variance = lean_effects(flights)
    lean = np.array([flight.lean for flight in flights])
    mean = np.array([flight.mean for flight in flights])
    error = np.array([flight.error for flight in flights])
    level = mean - np.einsum("fal,fl->fa", effect, lean)
    lean_variance = np.einsum("fal,fl->fa", variance, lean**2)
    return level, error**2 + lean_variance


def known_balance(flight: HealthFigures) -> BalanceFigures:
    """Returns the balance of a flight that has all that :attr:`HealthFigures.missing` asks."""
    assert flight.balance is not None
    return flight.balance


def lean_effects(flights: Sequence[BalanceFigures]) -> ArrayPair:
    """Returns (f, 3, 2) the effects of lean in each flight, and their variances: what it shows, drawn to the mean.

    How much they differ shows in the flights, and half of that is taken for what manoeuvres make of the estimates.
    """
    seen = np.array([flight.lean_effect for flight in flights])
    variance = np.array([flight.lean_effect_error for flight in flights]) ** 2
    finite = np.isfinite(seen) & np.isfinite(variance)
    seen = np.where(finite, seen, 0.0)
    variance = np.where(finite, variance, np.inf)
    count = finite.sum(axis=0)
    plain = seen.sum(axis=0) / np.maximum(count, 1)
    distance = (seen - plain) ** 2
    spread = np.where(finite, distance, 0.0).sum(axis=0)
    freedom = LEAN_EFFECT_FREEDOM + np.maximum(count - 1, 0)
    scatter = (LEAN_EFFECT_FREEDOM * LEAN_EFFECT_SCATTER**2 + spread) / freedom
    weights = 1 / (variance + scatter)
    total = weights.sum(axis=0) + LEAN_EFFECT**-2
    weighted = (weights * seen).sum(axis=0)
    mean = weighted / total
    own = 1 / (variance + scatter / 2)
    common = 1 / (scatter / 2 + 1 / total)
    known_share = own + common
    return (own * seen + common * mean) / known_share, 1 / known_share
