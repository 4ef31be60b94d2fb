"""Simulated flights with known physical parameters: vehicles × winds × steering, the rest drawn by seed."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle, product
from typing import Any, NamedTuple

import numpy as np

from mavdem import Flight
from mavdem.paper.flights import logged
from sitl_scenarios.files import scenario_of
from sitl_scenarios.motion import IN_AIR, Motion
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

SPEEDS = {"iris": 1.0, "ardrone2": 0.6, "crazyflie": 0.3}  # of the winds, relative to those below
MOMENTS = {"iris": 0.05, "ardrone2": 0.006, "crazyflie": 2e-5}  # N m, standard deviation
WINDS = ("calm", "light", "Dryden, light", "Dryden, moderate", "jet", "gusts", "slow")
STEERING: dict[str, dict[str, Any] | None] = {
    "none": None,
    "multisine": {"kind": "multisine", "sd": 3.0, "lowest": 0.2, "highest": 4.0, "period": 10.0},
    "doublets": {"kind": "doublets", "amplitude": 6.0, "width": 0.4, "period": 3.0},
    "side steps": {"kind": "steps", "distance": 2.0, "period": 5.0},
    "sticks": {"kind": "sticks"},
}
RATES = (50.0, 100.0, 200.0)  # Hz
AUTOPILOTS = ("px4", "ardupilot")
SECONDS = 60.0  # from arming to disarming
VARIED = 0.3  # share of flights whose thrust curve, lag, inertia and battery are not the published ones


class Case(NamedTuple):
    """One flight of the bank, and in words what it is."""

    vehicle: str
    wind: str
    steering: str
    rate: float
    autopilot: str
    varied: dict[str, float]
    seed: int

    def __str__(self) -> str:
        varied = ", ".join(f"{name} {value:.2f}" for name, value in self.varied.items())
        words = (self.vehicle, self.wind, self.steering, f"{self.rate:.0f} Hz", self.autopilot, varied)
        return "; ".join(word for word in words if word) + f"; seed {self.seed}"


def cases(seed: int, repeats: int, every: int = 1) -> list[Case]:
    """Every vehicle in every wind with every steering, ``repeats`` times, or one of ``every`` so many drawn by seed."""
    rng = np.random.default_rng(seed)
    places = list(product(SPEEDS, WINDS)) * repeats
    kept = len(places) // every
    # Steering, and rates with autopilots, take turns: a part of the bank has as many of each.
    drawn = [[places[number] for number in rng.permutation(len(places))[:kept]] for _ in STEERING]
    turns = [
        (*place, steering) for some in zip(*drawn, strict=True) for place, steering in zip(some, STEERING, strict=True)
    ]
    return [
        Case(vehicle, wind, steering, rate, autopilot, _varied(rng), int(rng.integers(1_000_000)))
        for (vehicle, wind, steering), (rate, autopilot) in zip(turns, cycle(product(RATES, AUTOPILOTS)), strict=False)
    ]


def _varied(rng: np.random.Generator) -> dict[str, float]:
    up = float(rng.uniform(0.015, 0.06))
    drawn = {
        "quadratic_thrust": float(rng.uniform(0.3, 1.0)),
        "lag_up": up,
        "lag_down": up * float(rng.uniform(1.0, 2.0)),
        "inertia_scale": float(rng.uniform(0.7, 1.6)),
        "battery_sag": float(rng.uniform(0.0, 0.15)),
    }
    return drawn if rng.random() < VARIED else {}


def scenario(case: Case) -> Scenario:
    """The scenario of a case."""
    k, moment = SPEEDS[case.vehicle], MOMENTS[case.vehicle]
    winds: dict[str, list[dict[str, Any]]] = {
        "calm": [],
        "light": [{"kind": "gaussian", "sd": 0.5 * k, "s": 0.2}],
        "Dryden, light": [{"kind": "dryden", "speed": 5 * k, "direction": 90.0, "wind_at_20_feet": 7.7 * k}],
        "Dryden, moderate": [{"kind": "dryden", "speed": 5 * k, "direction": 70.0, "wind_at_20_feet": 15.4 * k}],
        "jet": [{"kind": "jet", "speed": 6 * k, "distance": 3.0, "diameter": 0.5, "turbulence": 0.3, "s": 0.1}],
        "gusts": [
            {"kind": "steady", "speed": 5 * k, "direction": 80.0},
            {"kind": "gaussian", "sd": 1.5 * k, "s": 0.3},
        ],
        "slow": [{"kind": "von_karman", "speed": 4 * k, "direction": 120.0, "wind_at_20_feet": 10 * k}],
    }
    moments = {"gusts": [{"sd": moment, "s": 0.05}], "slow": [{"sd": moment / 2, "s": 0.3}]}
    values: dict[str, Any] = {
        "duration": SECONDS,
        "seed": case.seed,
        "height": 1.5 if case.wind == "jet" else 8.0,
        "vehicle": {"model": case.vehicle, **case.varied},
        "wind": winds[case.wind],
        "moments": moments.get(case.wind, []),
        "stream": {"rate": case.rate, "autopilot": case.autopilot},
    }
    if (steering := STEERING[case.steering]) is not None:
        values["excitation"] = steering
    return scenario_of(values)


class Flown(NamedTuple):
    """A flight as its log is read, and what the simulation knows."""

    flight: Flight
    motion: Motion
    scenario: Scenario

    def true(self, part: Flight) -> dict[str, Any]:
        """Each motor's effect (r,) at the trim of ``part``, damping (1/s) and lag (s), the mean of up and down."""
        within = (self.motion.time >= part.time[0]) & (self.motion.time <= part.time[-1])
        landed = np.where(within & (self.motion.landed_state == IN_AIR), IN_AIR, 1).astype(np.uint8)
        known = truth(self.scenario, replace(self.motion, landed_state=landed))
        return {"effect": known["roll_effect"], "damping": -float(known["roll_A"][1, 1]), "lag": known["lag"][0]}


def flown(case: Case) -> Flown:
    """Flies it, writes its telemetry log and reads that.

    Raises:
        NotLearnable: the log holds no settled flight.
    """
    of = scenario(case)
    return Flown(logged(of), fly(of), of)
