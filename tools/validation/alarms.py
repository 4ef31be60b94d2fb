#!/usr/bin/env python
"""Motor alarms in simulated flights: how soon they come, how often they are right, how often false; prints a table.

The table has a row for each kind of flight, parted by even and odd numbers of the flights. In some kinds a motor loses
a fifth of its thrust, or a propeller chips, also while another motor is weak: the row has how many of these were found
within five seconds, how many of those found were named right, and the delays. In others a load shifts, or nothing is
wrong but gusts, steps, sticks or take-offs disturb the flight: every alarm on a motor is false. The parameters of the
test were chosen on the flights with even numbers. To simulate all flights takes about forty minutes on two processors;
what a flight is follows from its kind and number.

Of recordings a row each is printed: the alarms of a live session, with fits that take no time, and how often 0 is in
the band of the torque.

Usage: tools/validation/alarms.py [--rate HZ of the motors] [--flights N of each kind at most] [--jobs N]
       tools/validation/alarms.py [--jobs N] RECORDING.tlog ...
"""

from functools import partial
from itertools import groupby
from pathlib import Path
from unittest.mock import Mock, patch

import click
import numpy as np
import pandas as pd
from flights import (
    ARMING_TIME,
    TABLES,
    Values,
    command,
    draw_values,
    evaluate_flights,
    half_name,
    percent_true,
    print_table,
    scenario_from_values,
    simulated_telemetry,
)
from numpy.random import default_rng

import mavdem.live.clock
from mavdem.assessment.axis.analysis import motor_alarms
from mavdem.dataset.phases import settled_intervals
from mavdem.dataset.signals import Signals
from mavdem.dem import Settings
from mavdem.facts.session import SessionFact
from mavdem.ingest.formats import read_stream
from mavdem.live import LiveStream
from mavdem.live.history import TORQUE_COLUMNS
from mavdem.live.link import ReceivedPiece
from mavdem.live.session import LiveSession
from mavdem.motors.motor_changes import MotorAlarm
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

BATCH_SECONDS = 0.01
"""Pieces of a recording that arrived in one such span of time are given to a live session at once, s; a choice."""

SOUND = "sound"
HOVER = "weak in hover"
WIND = "weak in wind"
CHIPPED = "chipped"
SHIFTED = "shifted load"
SECOND = "chipped while another is weak"
KINDS = {SOUND: 72, HOVER: 100, WIND: 100, CHIPPED: 40, SHIFTED: 120, SECOND: 40}
"""Flights of each kind; the sound ones of ten minutes, which makes twelve hours with about ten of them settled."""
CHIPPED_PROPELLER = {"thrust": 0.8, "torque": 0.76}
"""Thrust and torque of a chipped propeller, relative to a sound one."""

ARMS = {"iris": 250.0, "ardrone2": 178.0, "crazyflie": 43.0}
"""Length of the arm of each model, mm."""

SHIFT_RANGE = (0.05, 0.14)
"""Least and largest shift of the centre of mass by a load, relative to the arm."""


def scenario(kind: str, number: int, rate: float) -> Scenario:
    """Returns the scenario of a flight.

    Args:
        kind: kind of the flight, a key of ``KINDS``.
        number: number of the flight within its kind.
        rate: rate of the motors' messages, Hz.

    Returns:
        The validated scenario.
    """
    # Kind and number seed the random numbers, so that a flight is the same in every run.
    kind_number = list(KINDS).index(kind)
    rng = default_rng([kind_number, number])
    values = draw_values(TABLES["alarms"], rng) | {"seed": number, "duration": 50.0, "flights": 1}
    if kind == SOUND:
        # Three flights of a log, with take-offs between them.
        values |= {"duration": 200.0, "flights": 3}
    if kind != HOVER:
        values |= draw_values(TABLES["alarms_moved"], rng)
    # A fault comes after 24 to 32 s, so that sound flight precedes it; a second fault comes 6 to 14 s later.
    start = rng.uniform(24.0, 32.0)
    second_start = start + rng.uniform(6.0, 14.0)
    motor, other_motor = (rng.permutation(4)[:2] + 1).tolist()
    if kind in (HOVER, WIND, SECOND):
        values["vehicle"] |= {"weak_motor": motor, "weak_from": start, "weak_thrust": 0.8}
    if kind == CHIPPED:
        values["propeller"] = CHIPPED_PROPELLER | {"motor": motor, "start": start}
    elif kind == SECOND:
        values["propeller"] = CHIPPED_PROPELLER | {"motor": other_motor, "start": second_start}
    elif kind == SHIFTED:
        arm = ARMS[values["vehicle"]["model"]]
        shift = rng.uniform(*SHIFT_RANGE) * arm
        bearing = rng.uniform(0.0, 2 * np.pi)
        values["load"] = {
            "start": start,
            "forward": shift * np.cos(bearing),
            "right": shift * np.sin(bearing),
        }
    values["stream"]["rate"] = rate
    return scenario_from_values(values, "SERVO_OUTPUT_RAW")


def hours_and_alarms(flight: Scenario) -> tuple[float, tuple[MotorAlarm, ...]]:
    """Returns the hours of settled flight, and the alarms on motors and loads in it."""
    signals = Signals(simulated_telemetry(flight, fly(flight)))
    hours = sum(end - begin for begin, end in settled_intervals(signals, 0)) / 3600
    return hours, motor_alarms(signals)


def evaluate_flight(case: tuple[str, int], rate: float) -> list[Values]:
    """Simulates a flight, and returns the row of its results.

    Args:
        case: kind and number of the flight.
        rate: rate of the motors' messages, Hz.

    Returns:
        One row: the hours of settled flight, the "delay" of the first alarm after the fault, s, infinite without one,
        whether it names the "right" motor, and the number of alarms "on a motor".
    """
    kind, number = case
    flight = scenario(kind, number, rate)
    hours, alarms = hours_and_alarms(flight)
    vehicle = flight.vehicle
    propeller = flight.propeller
    if propeller.motor:
        scenario_time = propeller.start
    else:
        # Of a weak motor and a shifted load, the flight has one; the start of the other is 0.
        scenario_time = max(vehicle.weak_from, flight.load.start)
    fault_time = np.inf if kind == SOUND else scenario_time + ARMING_TIME
    first_alarm = next((alarm for alarm in alarms if alarm.time >= fault_time), None)
    row = {"flights": kind, "half": half_name(number), "hours": hours}
    row["delay"] = np.inf if first_alarm is None else first_alarm.time - fault_time
    faulty_motor = propeller.motor or vehicle.weak_motor
    row["right"] = first_alarm is not None and first_alarm.motor == faulty_motor
    row["on a motor"] = sum(alarm.motor is not None for alarm in alarms)
    return [row]


def alarm_statistics(flights: pd.DataFrame) -> pd.Series:
    """Returns the row of the flights of one kind and half: faults found, delays, and alarms on motors.

    Args:
        flights: rows of :func:`evaluate_flight`. The delay of a fault that was not found is infinite.

    Returns:
        Values by the headers of the table; delays are in s.
    """
    delays = flights["delay"]
    finite = delays[np.isfinite(delays)]
    line = {"number": len(flights), "hours settled": f"{flights['hours'].sum():.2f}"}
    # A fault counts as found soon within the five seconds that the module's docstring states.
    early = (delays <= 5.0).sum()
    line |= {"found in 5 s": early, "longest, s": f"{finite.max():.1f}"}
    line["named right, of found"] = f"{flights['right'].sum()} of {len(finite)}"
    line["median delay, s"] = f"{delays.median():.1f}"
    line["alarms on a motor"] = flights["on a motor"].sum()
    return pd.Series(line)


def evaluate_recording(recording: Path) -> list[Values]:
    """Returns the row of a recording: what a live session finds in it, on a clock that follows its time stamps.

    The clock of the session is replaced by one that stands at the stamp of the latest datagram, so that a recording
    takes no longer than its processing. Fits run between datagrams, and take no time on that clock.

    Args:
        recording: path of a telemetry log.

    Returns:
        One row: alarms and gusts that were found, and how much of the wind torque is known and consistent with 0.
    """
    stamped = read_stream(recording).stamped_frames()
    pieces = sorted(ReceivedPiece(stamp / 1e6, data) for stamp, data in stamped)
    link = Mock(awaits_greeting=False, dropped_datagrams=0, drain_events=list)
    with patch.object(mavdem.live.clock, "time") as clock:
        clock.monotonic = clock.time = Mock(return_value=pieces[0].arrival_time)
        session = LiveSession(
            link, LiveStream(), Settings(), Mock(return_value=None), Mock(), Mock()
        )
        for _, batch in groupby(pieces, lambda piece: piece.arrival_time // BATCH_SECONDS):
            received = list(batch)
            link.receive.return_value = received
            clock.time.return_value = received[-1].arrival_time
            session.step(0.0)
        alarms = session.status.motor_alarms
    history = session.history
    torque, band = history.table[:, TORQUE_COLUMNS].T
    finite = np.isfinite(torque)
    row: Values = {"recording": recording.stem}
    row["found"] = ", ".join(
        f"{alarm.time:.1f} s {alarm.name} {alarm.size:.0%}" for alarm in alarms
    )
    row["gusts"] = sum(event.fact.code is SessionFact.GUST_FELT for event in history.events)
    row["torque known"] = percent_true(finite)
    holds = abs(torque[finite]) <= band[finite]
    row["0 in band"] = percent_true(holds)
    return [row]


@command(__doc__, rate=10.0, flights=120)
@click.argument("recordings", nargs=-1, type=click.Path(exists=True, path_type=Path))
def main(recordings: tuple[Path, ...], rate: float, flights: int, jobs: int) -> None:
    """Prints how often weak motors are found in simulated flights, and how often falsely; or alarms in recordings.

    Args:
        recordings: recordings to take in the place of simulated flights; a row is printed for each.
        rate: rate of the motor outputs in simulated streams, Hz.
        flights: number of simulated flights of each kind at most.
        jobs: number of processes.
    """
    if recordings:
        rows = evaluate_flights(evaluate_recording, recordings, jobs)
        print_table("A live session", rows.sort_values("0 in band"))
        return
    cases = [
        (kind, number) for kind, count in KINDS.items() for number in range(min(count, flights))
    ]
    rows = evaluate_flights(partial(evaluate_flight, rate=rate), cases, jobs)
    lines = rows.groupby(["flights", "half"], sort=False).apply(alarm_statistics)
    print_table(f"Motors at {rate:g} Hz", lines.reset_index())


if __name__ == "__main__":
    main()
