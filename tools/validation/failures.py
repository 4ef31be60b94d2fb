#!/usr/bin/env python
"""What is said of flights in which motors failed, simulated to the ground; prints a row for each flight, and counts.

Quadrotors X and plus are flown and recorded as MAVLink. One motor fails or two do at once, and keep none of their
thrust or 30 to 70 %. A flight that is lost is over half a second after it hit the ground; of those that land by
themselves nothing must be said. Said right is an ending that names a motor that failed; wrong one that names another,
an ending of a flight that was not lost, and none of one that was. What a flight is follows from its number. It takes
about two minutes on two processors.

Usage: tools/validation/failures.py [--flights N] [--jobs N]
"""

from collections.abc import Sequence

import numpy as np
from flights import TABLES, Values, command, drawn, flight_of, rows_of, show, telemetry_of
from numpy.random import default_rng

from mavdem.alignment.signals import Signals
from mavdem.assessment.ending import ending_of
from mavdem.assessment.motion import HIT_SPEED, motion_events
from mavdem.facts import Fact
from sitl_scenarios.mavlink.transmitter import rows_of_motion
from sitl_scenarios.motion import Motion, joined
from sitl_scenarios.plan import BOOT_SECONDS
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import Simulation

SLOWED_SECONDS = 0.1  # within which the ground stops it
NOTHING_LEFT = 1e-3  # of its thrust


def to_the_ground(flight: Scenario, begin: float) -> tuple[Motion, bool]:
    """The flight until half a second after it hit the ground, from ``begin``, s, on; and whether it did."""
    simulation = Simulation(flight)
    second = round(1 / simulation.cycle)
    pieces = [simulation.advance(second)]
    while not simulation.finished:
        try:
            pieces.append(simulation.advance(second))
        except ValueError:  # it turns faster than anything that flies
            break
    motion = joined(pieces)
    stands = (motion.time > begin) & (motion.position[:, 2] > -0.05)
    hit = int(np.argmax(stands)) if stands.any() else len(motion) - 1
    sinking = motion.velocity[max(hit - round(SLOWED_SECONDS * second), 0) : hit + 1, 2]
    if stands.any() and sinking.max() <= HIT_SPEED:
        return motion, False
    return rows_of_motion(motion, slice(0, hit + second // 2)), True


def judged(number: int) -> list[Values]:
    """A row: what the flight of that number was, what was said of it, and how right that is."""
    rng = default_rng([41, number])
    values = drawn(TABLES["failures"], rng) | {"seed": number}
    kept = NOTHING_LEFT if rng.random() < 0.5 else rng.uniform(0.3, 0.7)
    begin = rng.uniform(18.0, 22.0)
    motors = (rng.permutation(4)[: 1 + (rng.random() < 0.4)] + 1).tolist()
    values["vehicle"] |= {"weak_motor": motors[0], "weak_from": begin, "weak_thrust": kept}
    if len(motors) > 1:
        chipped = {"motor": motors[1], "start": begin, "thrust": kept, "torque": kept}
        values["propeller"] = chipped
    flight = flight_of(values, "ATTITUDE_TARGET", "LOCAL_POSITION_NED")
    motion, lost = to_the_ground(flight, BOOT_SECONDS + begin)
    signals = Signals(telemetry_of(flight, motion), inputs="motors")
    ending = ending_of(signals, motion_events(signals))
    what = f"{flight.vehicle.frame} {flight.stream.autopilot} {flight.vehicle.model}"
    row = {"flight": number, "what": what, "motors": motors, "said": str(ending or "")}
    return [row | {"verdict": verdict(ending, motors, lost)}]


def verdict(ending: Fact | None, motors: Sequence[int], lost: bool) -> str:
    """How right an ending is."""
    if not lost:
        return "flew on, nothing said" if ending is None else "wrong: flew on"
    if ending is None:
        return "wrong: no ending"
    if not ending.subject:
        return "none named"
    is_right = any(ending.subject.startswith(f"motor {motor}") for motor in motors)
    return "right" if is_right else "wrong: another motor"


@command(__doc__, flights=60)
def main(flights: int, jobs: int) -> None:
    rows = rows_of(judged, range(flights), jobs)
    show("Flights", rows)
    show("How many", rows["verdict"].value_counts().reset_index())


if __name__ == "__main__":
    main()
