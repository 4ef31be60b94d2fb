"""Evidence of one flight: how its motors differ from those of healthy flights, and how probable each cause is."""

from __future__ import annotations

from dataclasses import dataclass

from mavdem.motors.change_hypotheses import ChangeHypotheses, ChangeProbabilities
from mavdem.motors.deviation import Deviation, deviation
from mavdem.motors.effort import EffortChange, effort_change
from mavdem.motors.healthy_flights import HealthFigures, HealthFlights

MIN_REPORTED_PROBABILITY = 0.5
"""Probability of a weak motor, or of any change, from which a flight is said to have one."""


@dataclass(frozen=True, eq=False)
class FlightEvidence:
    """What the comparison of one flight with healthy flights shows."""

    deviation: Deviation
    """Deviation of its balance."""
    hypotheses: ChangeHypotheses
    """Hypotheses on the cause."""
    change: ChangeProbabilities
    """How probable each cause is."""
    effort: EffortChange | None
    """Change of the effort; None where it is not known."""

    @property
    def change_probability(self) -> float:
        """Probability that the balance or the effort changed, 0 to 1.

        Both are taken as independent: the effort does not depend on which motor changed, and a weak motor changes the
        mean output only a little.
        """
        same_effort_probability = 1.0 if self.effort is None else 1 - self.effort.probability
        return 1 - self.change.unchanged_probability * same_effort_probability

    @property
    def is_changed(self) -> bool:
        """Whether the motors of the flight differ from those of the healthy flights.

        A deviation outside of nearly all healthy flights' is a change, even if no hypothesis explains it.
        """
        is_probable = self.change_probability >= MIN_REPORTED_PROBABILITY
        return is_probable or self.deviation.is_unusual

    @property
    def would_show_weak_motor(self) -> bool:
        """Whether the balance is so precise that a weak motor would have been found."""
        detection_probability = self.hypotheses.detection_probability(self.deviation)
        return detection_probability >= MIN_REPORTED_PROBABILITY


def flight_evidence(
    flight: HealthFigures, healthy: HealthFlights, previous: FlightEvidence | None = None
) -> FlightEvidence:
    """Compares a flight with healthy flights, by the balance of its motors and by their effort.

    The balance is the torque that the motors make in roll, pitch and yaw, relative to their thrust: one weak motor
    shifts it in its own direction. The effort is their mean output times the voltage. The deviation of the balance is
    computed first, then the probability of each cause of the deviation. A change that was found in the vehicle's
    previous flight probably persists, so the probabilities after that flight are the prior of this one.

    Args:
        flight: A flight whose needed figures are all known (``HealthFigures.missing`` is None).
        healthy: Healthy flights with the same motor geometry, without that flight.
        previous: Evidence of the vehicle's flight before this one; None for the first one.

    Returns:
        The deviation, and the probabilities of its causes.
    """
    assert flight.signatures is not None
    balance_prior = None if previous is None else previous.change.posterior
    effort_prior = None if previous is None else previous.effort
    # A signature is how the motors' commands change if one of the motors is weak.
    hypotheses = ChangeHypotheses(flight.signatures)
    flight_deviation = deviation(flight, healthy)
    return FlightEvidence(
        deviation=flight_deviation,
        hypotheses=hypotheses,
        change=hypotheses.cause_probabilities(flight_deviation, previous=balance_prior),
        effort=effort_change(flight, healthy, previous=effort_prior),
    )
