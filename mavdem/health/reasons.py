"""Reasons of an assessment in sentences, with their figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.health.balance import AXES
from mavdem.health.effort import EffortChange
from mavdem.health.explanations import SEEN, Explanations
from mavdem.health.reference import FEWEST_FLIGHTS, Deviation, HealthFigures

USUAL = 1.645  # Standard errors in half an interval of 90 %
EVEN = 0.5  # Probability of a change from which it is stated as the likelier
LEANS = np.radians(2.0)  # Difference of lean that is worth a sentence


class Compared(NamedTuple):
    """A flight's ``deviation`` and ``effort`` beside the healthy ``others``; ``chosen`` if these were named."""

    deviation: Deviation
    effort: EffortChange | None
    others: Sequence[HealthFigures]
    chosen: bool

    @property
    def reference(self) -> str:
        """What the flight is compared with."""
        named = "healthy flights" if self.chosen else "of the vehicle's first flights, taken for healthy"
        return f"{len(self.others)} {named}"


def too_few(usable: int, others: int, chosen: bool) -> str:
    """Why nothing is said where of the ``others`` of the vehicle only some are ``usable`` as healthy flights."""
    many = "is 1 other" if others == 1 else f"are {others or 'no'} others"
    have = f"there {many} of this vehicle"
    if others > usable:
        date = "" if chosen else "no date, "
        have += f", {others - usable} with {date}other motors, too little settled flight, or the same flight again"
    remedy = "fly or name more" if chosen else f"name {FEWEST_FLIGHTS} or more with --baseline"
    return f"Not enough healthy flights: {have}, and it takes {FEWEST_FLIGHTS} to show how much they differ; {remedy}."


def too_unsure(compared: Compared) -> str:
    """Why a flight that looks healthy is not called so."""
    away = compared.deviation
    unsure = ", ".join(
        f"{axis} ±{100 * USUAL * each:.1f} %"
        for axis, each in zip(AXES, np.hypot(away.scale, away.centre_error), strict=True)
    )
    return (
        f"Health is unknown: a motor that works {100 * SEEN:.0f} % harder would not show beside {compared.reference} "
        f"({unsure}), for the flight leans too much or is too short, or they differ too much."
    )


def of_fault(flight: HealthFigures, weighed: Explanations, compared: Compared, named: bool) -> str:
    """Which motor is weak, how sure that is, and how much harder it works if it is."""
    weak = f"a motor or propeller is weak (probability {weighed.fault:.2f})"
    if not named:
        return f"Beside {compared.reference}, {weak}; which one is not sure."
    motor, harder = _motor(flight, weighed, weighed.faulty)
    likely = weighed.faults.max()
    return (
        f"{motor[0].upper()}{motor[1:]} is weak, or its propeller, with probability {likely:.2f}; if so it works "
        f"{harder} harder than in {compared.reference}. That any is weak has probability {weighed.fault:.2f}."
    )


def of_drift(flight: HealthFigures, weighed: Explanations, compared: Compared, probability: float) -> str:
    """What changed, with its ``probability``, and what may explain it."""
    away = compared.deviation
    scale = np.hypot(away.scale, away.centre_error)
    changed = ", ".join(
        f"{axis} {100 * change:+.1f} % (usual ±{100 * USUAL * each:.1f} %)"
        for axis, change, each in zip(AXES, away.change, scale, strict=True)
    )
    sentence = f"With probability {probability:.2f} something changed from {compared.reference}"
    if away.beyond and probability < EVEN:
        return f"It is farther from {compared.reference} than 999 healthy flights in 1000 are: {changed}."
    balanced = 1 - weighed.healthy
    if compared.effort is not None and compared.effort.probability > balanced:
        return f"{sentence}, most likely the effort; the balance did with probability {balanced:.2f}."
    motor, harder = _motor(flight, weighed, weighed.suspect)
    parts = {
        "a load that shifted": weighed.load,
        "yaw alone, by a twisted arm or other propellers": weighed.yaw,
        "several things": weighed.other,
        f"{motor}, which would work {harder} harder": float(weighed.motors.max()),
    }
    likeliest = max(parts, key=lambda name: parts[name])
    return f"{sentence}: {changed}; most likely {likeliest} ({parts[likeliest]:.2f})."


def of_none(flight: HealthFigures, weighed: Explanations, compared: Compared, probability: float) -> str:
    """That nothing changed, with the ``probability`` that something did."""
    return f"No change is seen beside {compared.reference}; probability that something changed {probability:.2f}."


def _motor(flight: HealthFigures, weighed: Explanations, number: int) -> tuple[str, str]:
    """The name of a motor, from 1, and by how much it works harder if it is weak."""
    harder, low, high = (100 * float(value) for value in weighed.harder[:, number - 1])
    return flight.motors[number - 1], f"{harder:.0f} % ({low:.0f} to {high:.0f} %)"


def conditions(flight: HealthFigures, compared: Compared) -> list[str]:
    """Conditions that differ from those of the healthy flights, a sentence each."""
    sentences = []
    leans = [other.balance.lean for other in compared.others if other.balance is not None]
    if flight.balance is not None and leans:
        leaned = flight.balance.lean - np.mean(leans, axis=0)
        if np.abs(leaned).max() >= LEANS:
            by = ", ".join(f"{axis} {np.degrees(angle):+.1f}°" for axis, angle in zip(AXES, leaned, strict=False))
            sentences.append(f"It leans otherwise ({by}), by wind or speed; the balance is compared level.")
    effort = compared.effort
    if effort is not None and abs(effort.more) >= effort.usual:
        sentences.append(
            f"At the same voltage all motors together are commanded {100 * abs(effort.more):.0f} % "
            f"{'more' if effort.more > 0 else 'less'} (usual ±{100 * effort.usual:.0f} %): another payload, other air, "
            "or propellers that give another thrust."
        )
    return sentences
