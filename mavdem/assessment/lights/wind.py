"""The light of the wind: its speed where it is known, and how much of its lean the vehicle needs against it."""

from math import hypot, inf, radians

from mavdem.assessment.condition import Condition
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.estimator import estimator_light
from mavdem.facts import Fact, Level
from mavdem.facts.wind import WindLight
from mavdem.ingest.telemetry import Telemetry

LEAN_LIMITS = {"ANGLE_MAX": 0.01, "ATC_ANGLE_MAX": 1.0, "MPC_TILTMAX_AIR": 1.0}
"""Parameters of the largest lean, and what makes them degrees."""
MUCH_LEAN = 0.5  # of it: as much again is left for gusts and for moving against the wind


def wind_light(evidence: Evidence) -> Fact:
    """Returns the mean wind with its interval; unknown where the flight does not identify its speed."""
    wind, _, refusal = evidence.air
    if wind is None or not wind.speed_identifiable:
        because = refusal if wind is None else wind.reasons["speed"]
        return Fact(WindLight.WIND_NOT_KNOWN, because=because)
    low, high = wind.speed_interval
    share = _share_of_lean(evidence.condition, evidence.signals.telemetry)
    doubt = estimator_light(evidence)
    return Fact(
        WindLight.WIND_BLEW,
        Level.WATCH if doubt.is_bad or share > MUCH_LEAN and not wind.calm else None,
        calm=wind.calm,
        speed=wind.speed,
        low=low,
        high=high,
        direction=wind.direction if wind.direction_identifiable else None,
        share=share,
        because=doubt if doubt.is_bad else None,
    )


def _share_of_lean(condition: Condition, telemetry: Telemetry) -> float:
    """How much of the largest lean the mean of roll and pitch takes; 0 where either is not known."""
    limits = (telemetry.parameters.get(name, 0.0) * scale for name, scale in LEAN_LIMITS.items())
    limit = next((radians(angle) for angle in limits if angle > 0), inf)
    return hypot(*(lean.mean for lean in condition.lean.values())) / limit
