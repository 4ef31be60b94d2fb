"""The assessment of a vehicle's flights: which motor works too hard, by how much and how surely, or why not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

from mavdem.health import reasons
from mavdem.health.effort import EffortChange, effort_change
from mavdem.health.explanations import Candidates, Explanations
from mavdem.health.reference import FEWEST_FLIGHTS, HealthFigures, deviation, distinct_flights, healthy_flights

Health = Literal["ok", "drift", "fault", "unknown"]

FAULT = 0.5
"""Probability of a fault from which a flight is called one. ``tools/validation/propellers.py`` prints how many healthy
flights are by chance, and the same of ``DRIFT``."""
DRIFT = 0.5  # Probability of any change from which a flight is called a drift
NAMED = 0.8  # A motor is named if, given that one is faulty, it is that one with this probability


class Assessment(NamedTuple):
    """What the figures of one flight say of its motors.

    Attributes:
        health: "fault": a motor works 8 % harder or more than in healthy flights, for it or its propeller is weak;
            "drift": the balance changed, by less or not by a motor, or the effort did; "ok": as in healthy flights,
            and a motor that works 20 % harder would have shown; "unknown": ``reason`` says what is missing.
        fault_probability: that some motor works 8 % harder or more, for it or its propeller is weak; None where
            unknown.
        change_probability: that anything changed, faults included; None where unknown.
        suspect_motor: from 1, of a fault where one is named.
        suspect_probability: that the suspect motor is the one, and works 8 % harder or more; at most
            ``fault_probability``.
        harder: by how much it works harder if it is weak, %, with the ends of the interval of 90 %.
        reason: sentences with figures.
    """

    health: Health
    fault_probability: float | None
    change_probability: float | None
    suspect_motor: int | None
    suspect_probability: float | None
    harder: tuple[float, float, float] | None
    reason: str


def assess(flights: Sequence[HealthFigures], baseline: Sequence[HealthFigures] | None = None) -> tuple[Assessment, ...]:
    """Judges each flight of one vehicle against its healthy ones; a healthy one against the other healthy ones.

    Flights with a date are judged in its order, from what is known after those before.

    Args:
        flights: of one vehicle.
        baseline: its healthy flights, of ``flights`` or others; its first three by date unless given. A flight that
            was logged twice counts once.
    """
    chosen = baseline is not None
    named = flights if baseline is None else baseline
    usable = [flight for flight in (healthy_flights(flights) if baseline is None else baseline) if not flight.missing]
    healthy = distinct_flights(usable)
    found: dict[int, Assessment] = {}
    candidates: dict[object, Candidates] = {}
    before: dict[object, tuple[Explanations, EffortChange | None]] = {}
    for number in sorted(range(len(flights)), key=lambda number: _when(flights[number])):
        flight = flights[number]
        apart = [other for other in healthy if other is not flight and not other.overlaps(flight)]
        others = [other for other in apart if other.layout == flight.layout]
        if flight.missing or flight.signatures is None:
            found[number] = _unknown(f"Health is unknown: {flight.missing}.")
        elif len(others) < FEWEST_FLIGHTS:
            found[number] = _unknown(reasons.too_few(len(others), sum(other is not flight for other in named), chosen))
        else:
            if flight.layout not in candidates:
                candidates[flight.layout] = Candidates(flight.signatures)
            considered = candidates[flight.layout]
            # One of unknown date says nothing of what comes next, and one that was chosen as healthy stands alone.
            alone = flight.date is None or flight in healthy or len(apart) < len(healthy)
            last, last_effort = (None, None) if alone else before.get(flight.layout, (None, None))
            away = deviation(flight, others)
            weighed = considered.after(away, None if last is None else last.candidates)
            effort = effort_change(flight, others, last_effort)
            if not alone:
                before[flight.layout] = weighed, effort
            compared = reasons.Compared(away, effort, others, chosen)
            found[number] = _judged(flight, weighed, compared)
            if found[number].health == "ok" and considered.shown(away) < DRIFT:
                found[number] = _unknown(
                    " ".join([reasons.too_unsure(compared), *reasons.conditions(flight, compared)])
                )
    return tuple(found[number] for number in range(len(flights)))


def _when(flight: HealthFigures) -> tuple[bool, float]:
    """Sorts by date, flights without one last."""
    return flight.date is None, 0.0 if flight.date is None else flight.date.timestamp()


def _unknown(reason: str) -> Assessment:
    return Assessment("unknown", None, None, None, None, None, reason)


def _judged(flight: HealthFigures, weighed: Explanations, compared: reasons.Compared) -> Assessment:
    # The effort says nothing of a single motor, and a weak one takes little of it.
    same = weighed.healthy * (1.0 if compared.effort is None else 1 - compared.effort.probability)
    if weighed.fault >= FAULT:
        named = float(weighed.faults.max()) >= NAMED * weighed.fault
        harder, low, high = (100 * float(value) for value in weighed.harder[:, weighed.faulty - 1])
        reason = " ".join([reasons.of_fault(flight, weighed, compared, named), *reasons.conditions(flight, compared)])
        if not named:
            return Assessment("fault", weighed.fault, 1 - same, None, None, None, reason)
        likely = float(weighed.faults.max())
        return Assessment("fault", weighed.fault, 1 - same, weighed.faulty, likely, (harder, low, high), reason)
    # Whatever the weights of the explanations are, what healthy flights do not show is a change.
    health: Health = "drift" if 1 - same >= DRIFT or compared.deviation.beyond else "ok"
    sentence = reasons.of_drift if health == "drift" else reasons.of_none
    reason = " ".join([sentence(flight, weighed, compared, 1 - same), *reasons.conditions(flight, compared)])
    return Assessment(health, weighed.fault, 1 - same, None, None, None, reason)
