#!/usr/bin/env python
"""Motor alarms (a motor has lost thrust) in simulated flights: how soon they come, how often they are right or false.

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

from collections.abc import Callable
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
from numpy.random import Generator, default_rng

import mavdem.live.clock
from mavdem.assessment.motor_alarms import motor_alarms
from mavdem.dataset.phases import settled_intervals
from mavdem.dataset.signals import Signals
from mavdem.dem import Settings
from mavdem.facts.session import SessionFact
from mavdem.ingest.formats import read_stream
from mavdem.live import LiveStream
from mavdem.live.history import TORQUE_COLUMNS
from mavdem.live.link import ReceivedPiece
from mavdem.live.session import LiveSession
from mavdem.motors.motor_changes import MotorChange
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

MAX_EARLY_DELAY = 5.0
"""Largest delay of an alarm on a fault that counts as found soon, s: a choice."""

ARMS = {"iris": 250.0, "ardrone2": 178.0, "crazyflie": 43.0}
"""Length of the arm of each model, mm."""

SHIFT_RANGE = (0.05, 0.14)
"""Least and largest shift of the centre of mass by a load, relative to the arm."""


def scenario(kind: str, number: int, rate: float) -> Scenario:
    """Draws the scenario of a flight, and adds the fault of its kind: a weak motor, a chipped propeller or a load.

    Args:
        kind: kind of the flight, which says what fails, a key of ``KINDS``.
        number: number of the flight within its kind. Both seed the draw, so that a flight is the same in every run.
        rate: rate of the motors' messages, Hz.

    Returns:
        The validated scenario.
    """
    kind_number = list(KINDS).index(kind)
    rng = default_rng([kind_number, number])
    values = draw_values(TABLES["alarms"], rng) | {"seed": number, "duration": 50.0, "flights": 1}
    if kind == SOUND:
        # Three flights of a log, with take-offs between them.
        values |= {"duration": 200.0, "flights": 3}
    if kind == SECOND:
        # The vehicle lands in the last ten seconds; the second fault is to come well before.
        values |= {"duration": 70.0}
    if kind != HOVER:
        values |= draw_values(TABLES["alarms_in_disturbed_flight"], rng)
    _add_fault(values, kind, rng)
    values["stream"]["rate"] = rate
    return scenario_from_values(values, "SERVO_OUTPUT_RAW")


def _add_fault(values: Values, kind: str, rng: Generator) -> None:
    """Adds the fault of a kind of flights to a scenario: a motor that weakens, a propeller that chips or a load.

    A load shifts the centre of mass, to which motors must answer as if one were weak, though none is.

    Args:
        values: values of the scenario by section, which are changed in place.
        kind: kind of the flight, a key of ``KINDS``; some have no fault.
        rng: source of the random numbers.
    """
    # The fault comes at a random time in the flight of 50 s, after enough sound flight to compare with. In some
    # flights a second fault follows while the first one lasts. Both are choices, in s after arming.
    start = rng.uniform(24.0, 32.0)
    second_start = start + rng.uniform(6.0, 14.0)
    # Numbers of two different motors of the four, from 1.
    motor, other_motor = (rng.permutation(4)[:2] + 1).tolist()
    if kind in (HOVER, WIND, SECOND):
        # The motor gives 80 % of its thrust from then on.
        values["vehicle"] |= {"weak_motor": motor, "weak_from": start, "weak_thrust": 0.8}
    if kind == CHIPPED:
        values["propeller"] = CHIPPED_PROPELLER | {"motor": motor, "start": start}
    elif kind == SECOND:
        values["propeller"] = CHIPPED_PROPELLER | {"motor": other_motor, "start": second_start}
    elif kind == SHIFTED:
        arm_length = ARMS[values["vehicle"]["model"]]
        shift = rng.uniform(*SHIFT_RANGE) * arm_length
        bearing = rng.uniform(0.0, 2 * np.pi)
        values["load"] = {
            "start": start,
            "forward": shift * np.cos(bearing),
            "right": shift * np.sin(bearing),
        }


def flight_hours_and_alarms(flight: Scenario) -> tuple[float, tuple[MotorChange, ...]]:
    """Simulates a flight, and returns its hours of settled flight and the alarms on motors and loads.

    Args:
        flight: scenario of the flight.
    """
    signals = Signals(simulated_telemetry(flight, fly(flight)))
    settled_seconds = sum(end - begin for begin, end in settled_intervals(signals, 0))
    return settled_seconds / 3600, motor_alarms(signals)


def start_of_fault(flight: Scenario) -> float:
    """Returns when the fault of a flight begins that an alarm should report, s of the recording; infinite without one.

    Of two faults it is the second, a chipped propeller.

    Args:
        flight: scenario of the flight, whose own times count from the arming.
    """
    if flight.propeller.motor:
        return flight.propeller.start + ARMING_TIME
    if flight.vehicle.weak_motor:
        return flight.vehicle.weak_from + ARMING_TIME
    if flight.load.forward or flight.load.right:
        return flight.load.start + ARMING_TIME
    return np.inf


def evaluate_flight(case: tuple[str, int], rate: float) -> list[Values]:
    """Simulates a flight, and compares the motor alarms in it with its fault.

    Args:
        case: kind and number of the flight.
        rate: rate of the motors' messages, Hz.

    Returns:
        One row by column: the kind of "flights" and their "half" (even or odd number); the "hours" of settled flight;
        the "delay" of the first alarm after the fault, s, infinite without one; whether that alarm names the "right"
        motor; and the number of alarms "on a motor" rather than on a load.
    """
    kind, number = case
    flight = scenario(kind, number, rate)
    hours, alarms = flight_hours_and_alarms(flight)
    fault_time = start_of_fault(flight)
    faulty_motor = flight.propeller.motor or flight.vehicle.weak_motor
    delay = np.inf
    names_right_motor = False
    alarms_after_fault = [alarm for alarm in alarms if alarm.time >= fault_time]
    if alarms_after_fault:
        first_alarm = alarms_after_fault[0]
        delay = first_alarm.time - fault_time
        names_right_motor = first_alarm.motor == faulty_motor
    row = {
        "flights": kind,
        "half": half_name(number),
        "hours": hours,
        "delay": delay,
        "right": names_right_motor,
        "on a motor": sum(alarm.motor is not None for alarm in alarms),
    }
    return [row]


def alarm_statistics(flights: pd.DataFrame) -> pd.Series:
    """Summarises the flights of one kind with even or with odd numbers: faults found, delays, and alarms on motors.

    Args:
        flights: rows of :func:`evaluate_flight`. The delay of a fault that was not found is infinite.

    Returns:
        The row of the table, by its headers; delays are in s.
    """
    delays = flights["delay"]
    delays_of_found_faults = delays[np.isfinite(delays)]
    found_faults = len(delays_of_found_faults)
    cells = {
        "number": len(flights),
        "hours settled": f"{flights['hours'].sum():.2f}",
        f"found in {MAX_EARLY_DELAY:g} s": (delays <= MAX_EARLY_DELAY).sum(),
        "longest, s": f"{delays_of_found_faults.max():.1f}",
        "named right, of found": f"{flights['right'].sum()} of {found_faults}",
        "median delay, s": f"{delays.median():.1f}",
        "alarms on a motor": flights["on a motor"].sum(),
    }
    return pd.Series(cells)


def _never(session: LiveSession) -> bool:
    """Returns False: the whole recording is played."""
    return False


def replayed_session(
    recording: Path, is_over: Callable[[LiveSession], bool] = _never
) -> LiveSession:
    """Plays a recorded telemetry stream to a live session as fast as it is processed, and returns the session.

    The session reads its link and its clock, so both are stand-ins here: the link returns the datagrams of one batch
    after the other, and the clock stands at the stamp of the latest one. Models are learned in the same thread between
    two batches, which takes no time on that clock. Nothing is displayed or reported.

    Args:
        recording: path of a telemetry log.
        is_over: is called after each batch, on the clock of the recording, and returns whether no more is played.
    """
    stamped_frames = read_stream(recording).stamped_frames()
    # Stamps are in µs.
    datagrams = sorted(ReceivedPiece(stamp / 1e6, frame) for stamp, frame in stamped_frames)
    link = Mock(awaits_greeting=False, dropped_datagrams=0, drain_events=list)
    open_no_display = Mock(return_value=None)
    with patch.object(mavdem.live.clock, "time") as clock:
        clock.monotonic = clock.time = Mock(return_value=datagrams[0].arrival_time)
        session = LiveSession(
            link,
            LiveStream(),
            Settings(),
            open_display=open_no_display,
            report_status=Mock(),
            report_event=Mock(),
        )
        for _, batch in groupby(datagrams, _batch_number):
            received = list(batch)
            link.receive.return_value = received
            clock.time.return_value = received[-1].arrival_time
            session.step(0.0)
            if is_over(session):
                break
    return session


def _batch_number(datagram: ReceivedPiece) -> float:
    """Returns the number of the batch of ``BATCH_SECONDS`` in which a datagram arrived."""
    return datagram.arrival_time // BATCH_SECONDS


def evaluate_recording(recording: Path) -> list[Values]:
    """Plays a recording to a live session, and returns what the session finds in it.

    Args:
        recording: path of a telemetry log.

    Returns:
        One row by column: "recording", its name; the motor alarms that were "found"; the number of "gusts"; "torque
        known", the percentage of samples with an estimate of the wind torque; and "0 in band", the percentage of these
        whose 90 % band contains 0, as in calm air.
    """
    session = replayed_session(recording)
    alarm_texts = [
        f"{alarm.time:.1f} s {alarm.name} {alarm.size:.0%}" for alarm in session.status.motor_alarms
    ]
    history = session.history
    gusts = [event for event in history.events if event.fact.code is SessionFact.GUST_FELT]
    torque, half_width = history.table[:, TORQUE_COLUMNS].T
    is_known = np.isfinite(torque)
    is_zero_in_band = abs(torque[is_known]) <= half_width[is_known]
    row = {
        "recording": recording.stem,
        "found": ", ".join(alarm_texts),
        "gusts": len(gusts),
        "torque known": percent_true(is_known),
        "0 in band": percent_true(is_zero_in_band),
    }
    return [row]


@command(__doc__, rate=10.0, flights=120)
@click.argument("recordings", nargs=-1, type=click.Path(exists=True, path_type=Path))
def main(recordings: tuple[Path, ...], rate: float, flights: int, jobs: int) -> None:
    """Prints a row of alarm statistics for each kind of simulated flights, or the alarms in recordings.

    Args:
        recordings: telemetry logs that are played to a live session instead; a row is printed for each.
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
