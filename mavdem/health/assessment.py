"""The assessment of a vehicle's flights: which motor works too hard, by how much and how surely, or why not.

Each verdict comes with its reason in sentences, with their figures.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from mavdem.alignment.drive import AXES
from mavdem.health.explanations import Candidates, EffortChange, Explanations, effort_change, lost_thrust
from mavdem.health.reference import FEWEST_FLIGHTS, Deviation, HealthFigures, deviation, healthy_flights

Health = Literal["ok", "drift", "fault", "unknown"]

FAULT = DRIFT = 0.5
"""Probability of a fault, and of any change, from which a flight is called one. ``tools/validation/propellers.py``
prints how many healthy flights are by chance."""
NAMED = 0.8  # A motor is named if, given that one is faulty, it is that one with this probability
MIN_LEAN = np.radians(2.0)  # Difference of lean that is worth a sentence


class Assessment(NamedTuple):
    """What the figures of one flight say of its motors."""

    # "fault": a motor works 8 % harder or more than in healthy flights, for it or its propeller is weak; "drift": the
    # balance changed, by less or not by a motor, or the effort did; "ok": as in healthy flights, and a motor that
    # works 20 % harder would have shown; "unknown": ``reason`` says what is missing
    health: Health
    reason: str  # sentences with figures
    # that some motor works 8 % harder or more, for it or its propeller is weak; None where unknown
    fault_probability: float | None = None
    change_probability: float | None = None  # that anything changed, faults included; None where unknown
    suspect_motor: int | None = None  # from 1, of a fault where one is named
    # that the suspect motor is the one, and works 8 % harder or more; at most ``fault_probability``
    suspect_probability: float | None = None
    # by how much it works harder if it is weak, %, with the ends of the interval of 90 %
    harder: tuple[float, float, float] | None = None


def assess(flights: Sequence[HealthFigures], baseline: Sequence[HealthFigures] | None = None) -> tuple[Assessment, ...]:
    """Judges each flight of one vehicle against its healthy ones; a healthy one against the other healthy ones.

    Flights with a date are judged in its order, from what is known after those before.

    Args:
        flights: of one vehicle.
        baseline: its healthy flights, of ``flights`` or others; its first three sound ones by date unless given. A
            flight that was logged twice counts once.
    """
    chosen = baseline is not None
    named = flights if baseline is None else baseline
    healthy = healthy_flights(flights, baseline)
    verdicts: dict[int, Assessment] = {}
    candidates: dict[object, Candidates] = {}
    before: dict[object, tuple[Explanations, EffortChange | None]] = {}
    for number in sorted(range(len(flights)), key=lambda number: flights[number].when):
        flight = flights[number]
        apart = [other for other in healthy if other is not flight and not other.overlaps(flight)]
        others = [other for other in apart if other.layout == flight.layout]
        if flight.missing or flight.signatures is None:
            verdicts[number] = Assessment("unknown", f"Health is unknown: {flight.missing}.")
            continue
        if len(others) < FEWEST_FLIGHTS:
            reason = _too_few(len(others), sum(other is not flight for other in named), chosen)
            verdicts[number] = Assessment("unknown", reason)
            continue
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
        reference = "healthy flights" if chosen else "of the vehicle's first sound flights, taken for healthy"
        verdict = _verdict(flight, weighed, away, effort, f"{len(others)} {reference}")
        if verdict.health == "ok" and considered.shown(away) < DRIFT:
            verdict = Assessment("unknown", _too_unsure(away, f"{len(others)} {reference}"))
        conditions = " ".join([verdict.reason, *_conditions(flight, others, effort)])
        verdicts[number] = verdict._replace(reason=conditions)
    return tuple(verdicts[number] for number in range(len(flights)))


def _verdict(
    flight: HealthFigures, weighed: Explanations, away: Deviation, effort: EffortChange | None, reference: str
) -> Assessment:
    """The verdict beside the flights of the ``reference``, with what speaks for it."""
    # The effort says nothing of a single motor, and a weak one takes little of it.
    change = 1 - weighed.healthy * (1.0 if effort is None else 1 - effort.probability)
    if weighed.fault >= FAULT:
        likely = float(weighed.faults.max())
        if likely < NAMED * weighed.fault:
            reason = f"A motor or propeller lost thrust (probability {weighed.fault:.2f}), beside {reference}; which"
            return Assessment("fault", f"{reason} one is not sure.", weighed.fault, change)
        suspect = int(weighed.faults.argmax())
        name, lost, harder = _motor(flight, weighed, suspect)
        reason = (
            f"{name[0].upper()}{name[1:]} {lost} with probability {likely:.2f}: it then works {harder} harder than "
        )
        reason += f"in {reference}. That any motor lost thrust has probability {weighed.fault:.2f}."
        mean, low, high = (100 * float(value) for value in weighed.harder[:, suspect])
        return Assessment("fault", reason, weighed.fault, change, suspect + 1, likely, (mean, low, high))
    # Whatever the weights of the explanations are, what healthy flights do not show is a change.
    if change >= DRIFT or away.beyond:
        return Assessment("drift", _drift(flight, weighed, away, effort, change, reference), weighed.fault, change)
    reason = f"No change is seen beside {reference}; probability that something changed {change:.2f}."
    return Assessment("ok", reason, weighed.fault, change)


def _drift(
    flight: HealthFigures,
    weighed: Explanations,
    away: Deviation,
    effort: EffortChange | None,
    probability: float,
    reference: str,
) -> str:
    """What changed, with its ``probability``, and what may explain it."""
    each = zip(AXES, away.change, away.usual, strict=True)
    changed = ", ".join(f"{axis} {100 * by:+.1f} % (usual ±{100 * usual:.1f} %)" for axis, by, usual in each)
    if away.beyond and probability < DRIFT:
        return f"Outside the 99.9 % range of {reference}: {changed}."
    differs = f"Differs from {reference} (probability {probability:.2f})"
    balance = 1 - weighed.healthy
    if effort is not None and effort.probability > balance:
        more = f"{100 * abs(effort.more):.0f} % {'harder' if effort.more > 0 else 'less hard'}"
        return f"{differs}: all motors work {more}. The balance differs with probability {balance:.2f}."
    name, _, harder = _motor(flight, weighed, int(weighed.motors.argmax()))
    causes = {
        "a load that shifted": weighed.load,
        "yaw alone, by a twisted arm or other propellers": weighed.yaw,
        "several things": weighed.other,
        f"{name}, which would work {harder} harder": float(weighed.motors.max()),
    }
    likeliest = max(causes, key=lambda cause: causes[cause])
    return f"{differs}: {changed}; most likely {likeliest} ({causes[likeliest]:.2f})."


def _motor(flight: HealthFigures, weighed: Explanations, number: int) -> tuple[str, str, str]:
    """The name of a motor, from 0, how much thrust it lost if it is weak, and by how much it then works harder."""
    rises = [float(value) for value in weighed.harder[:, number]]
    mean, low, high = (100 * lost_thrust(rise) for rise in rises)
    lost = f"lost about {mean:.0f} % of its thrust ({low:.0f} to {high:.0f} %; motor or propeller)"
    mean, low, high = (100 * rise for rise in rises)
    return flight.motors[number], lost, f"{mean:.0f} % ({low:.0f} to {high:.0f} %)"


def _too_few(usable: int, others: int, chosen: bool) -> str:
    """Why nothing is said where of the ``others`` of the vehicle only some are ``usable`` as healthy flights."""
    many = "is 1 other" if others == 1 else f"are {others or 'no'} others"
    have = f"there {many} of this vehicle"
    if others > usable:
        date = "" if chosen else "no date, a motor at its limit, an oscillation, "
        have += f", {others - usable} with {date}other motors, too little settled flight, or the same flight again"
    remedy = "fly or name more" if chosen else f"name {FEWEST_FLIGHTS} or more with --baseline"
    return f"Not enough healthy flights: {have}, and it takes {FEWEST_FLIGHTS} to show how much they differ; {remedy}."


def _too_unsure(away: Deviation, reference: str) -> str:
    """Why a flight that looks healthy is not called so."""
    unsure = ", ".join(f"{axis} ±{100 * usual:.1f} %" for axis, usual in zip(AXES, away.usual, strict=True))
    lost = f"a motor that lost {100 * lost_thrust():.0f} % of its thrust would not show beside {reference} ({unsure})"
    return f"Health is unknown: {lost}, for the flight leans too much or is too short, or they differ too much."


def _conditions(flight: HealthFigures, others: Sequence[HealthFigures], effort: EffortChange | None) -> list[str]:
    """Conditions that differ from those of the healthy flights, a sentence each."""
    sentences = []
    leans = [other.balance.lean for other in others if other.balance is not None]
    if flight.balance is not None and leans:
        leaned = flight.balance.lean - np.mean(leans, axis=0)
        if np.abs(leaned).max() >= MIN_LEAN:
            here, there = (
                ", ".join(f"{axis} {np.degrees(angle):+.1f}°" for axis, angle in zip(AXES, lean, strict=False))
                for lean in (flight.balance.lean, np.mean(leans, axis=0))
            )
            sentences.append(f"Its mean lean is {here}, that of the healthy flights {there}; both are compared level.")
    if effort is not None and abs(effort.more) >= effort.usual:
        sentences.append(
            f"At the same voltage all motors together are commanded {100 * abs(effort.more):.0f} % "
            f"{'more' if effort.more > 0 else 'less'} (usual ±{100 * effort.usual:.0f} %): another payload, other air, "
            "or propellers that give another thrust."
        )
    return sentences
