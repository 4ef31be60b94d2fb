"""A restart of the autopilot in flight is told from one on the ground."""

from dataclasses import replace

import numpy as np
from hover import ARMED, Hover, changed, columns, evidence_of, with_texts
from pytest import mark

from mavdem.assessment.judgement import judge
from mavdem.assessment.reported import reported_events
from mavdem.dataset.signals import Signals
from mavdem.facts import Level
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light

RESTARTS = (ReportedEvent.RESTARTED, ReportedEvent.RESTARTED_IN_FLIGHT)


def restart_events(telemetry):
    return [event for event in reported_events(Signals(telemetry)) if event.code in RESTARTS]


def telemetry_of_fall(height, tumbling):
    """A log that begins 0.5 s after the boot, while the vehicle falls; the motors are off."""
    telemetry = Hover(hovering=8.0).telemetry(10.0, 10.0)
    time = telemetry.messages["LOCAL_POSITION_NED"]["time"]
    speed = np.where(time < 4.0, height / 4.0, 0.0)
    fall = np.cumsum(speed) * (time[1] - time[0])
    telemetry = changed(
        telemetry, "LOCAL_POSITION_NED", x=0.0, y=0.0, z=fall, vx=0.0, vy=0.0, vz=speed
    )
    telemetry = changed(telemetry, "HEARTBEAT", base_mode=0)
    telemetry = changed(
        telemetry, "SERVO_OUTPUT_RAW", **{f"servo{n}_raw": 1000 for n in range(1, 5)}
    )
    attitude_time = telemetry.messages["ATTITUDE"]["time"]
    roll = 2.0 * np.sin(3.0 * attitude_time) * tumbling * (attitude_time < 4.0)
    return changed(telemetry, "ATTITUDE", roll=roll)


@mark.parametrize(
    "text",
    [
        b"WDG: T-3 SL0 FL123 FT3",
        b"Forcing logging for watchdog reset",
        b"PreArm: Internal errors (0x800)",
    ],
)
def test_a_watchdog_reset_and_a_fall_are_a_restart_in_flight(text):
    """After the restart a text names the watchdog, and the vehicle falls 20 m."""
    (event,) = restart_events(with_texts(telemetry_of_fall(20.0, tumbling=False), text))
    assert event.code is ReportedEvent.RESTARTED_IN_FLIGHT
    assert event.level is Level.BAD
    assert event.figures["watchdog"]
    assert 15.0 < event.figures["descent"] <= 20.5
    # The last metre of the fall counts as rest.
    assert 3.6 < event.figures["impact"] < 4.1


def test_a_fall_after_a_watchdog_reset_is_the_headline_and_the_light_of_tracking():
    telemetry = with_texts(telemetry_of_fall(20.0, tumbling=False), b"WDG: T-3 SL0 FL123 FT3")
    events = tuple(restart_events(telemetry))
    judgement = judge(evidence_of(Signals(telemetry), events=events))
    assert judgement.headline == events[0] and judgement.headline.is_bad
    assert judgement.lights[Light.TRACKING] == events[0]


def test_the_watchdog_is_stated_once():
    texts = (b"WDG: T-3 SL0 FL123 FT3", b"Forcing logging for watchdog reset")
    for telemetry, codes in (
        (telemetry_of_fall(20.0, tumbling=False), [ReportedEvent.RESTARTED_IN_FLIGHT]),
        (telemetry_of_fall(0.0, tumbling=False), [ReportedEvent.AUTOPILOT_ERROR]),
    ):
        events = reported_events(Signals(with_texts(telemetry, *texts)))
        stated = (ReportedEvent.RESTARTED_IN_FLIGHT, ReportedEvent.AUTOPILOT_ERROR)
        assert [event.code for event in events if event.code in stated] == codes


def test_a_watchdog_reset_on_the_ground_is_none_in_flight():
    still = telemetry_of_fall(0.0, tumbling=False)
    assert not restart_events(with_texts(still, b"WDG: T-3 SL0 FL123 FT3"))
    assert not restart_events(with_texts(still, b"PreArm: Internal errors (0x2)"))


def test_other_words_on_a_watchdog_are_no_reset():
    fallen = with_texts(telemetry_of_fall(20.0, tumbling=False), b"wdg ok, no reset")
    assert not restart_events(fallen)
    codes = {event.code for event in reported_events(Signals(fallen))}
    assert ReportedEvent.AUTOPILOT_ERROR not in codes


def test_words_that_look_like_hexadecimal_numbers_are_no_reset():
    fallen = telemetry_of_fall(20.0, tumbling=False)
    assert not restart_events(with_texts(fallen, b"Internal error: feed failed"))


def test_without_a_report_a_fall_and_a_tumble_are_needed():
    (event,) = restart_events(telemetry_of_fall(30.0, tumbling=True))
    assert event.code is ReportedEvent.RESTARTED_IN_FLIGHT
    assert not event.figures["watchdog"]
    assert not restart_events(telemetry_of_fall(30.0, tumbling=False))
    assert not restart_events(telemetry_of_fall(4.0, tumbling=True))


def test_a_reboot_between_flights_is_one_on_the_ground():
    """The second boot of the log begins level and at rest."""
    telemetry = Hover(hovering=8.0).telemetry(10.0, 10.0)
    second = columns(np.arange(0.5, 20.0, 0.1), boot=1, roll=0.0, pitch=0.0, yaw=0.0)
    first = telemetry.messages["ATTITUDE"]
    zeros = np.zeros(len(second["time"]))
    joined_columns = {
        name: np.concatenate([values, second.get(name, zeros)]) for name, values in first.items()
    }
    events = restart_events(changed(telemetry, "ATTITUDE", **joined_columns))
    assert [event.code for event in events] == [ReportedEvent.RESTARTED]


@mark.parametrize(
    "is_still, delays, code",
    [
        (True, {}, RESTARTS[0]),
        (False, {}, RESTARTS[1]),
        # Nobody lands and restarts the autopilot within 1.5 s.
        (True, {1: 1.5}, RESTARTS[1]),
        (True, {1: 20.0}, RESTARTS[0]),
        # A clock that began long before the flight ended is not of this autopilot.
        (True, {1: -20.0}, RESTARTS[0]),
    ],
)
def test_a_recording_that_begins_three_seconds_before_the_take_off_begins_on_the_ground(
    is_still, delays, code
):
    """The log before ended in the air; in this one the motors run from 3 s on, and armed it is from the first on.

    The delay is the time from the last message of the flight to the start of the autopilot's clock.
    """
    telemetry = Hover(hovering=8.0).telemetry(50.0, 50.0)
    messages = {}
    for name, table in telemetry.messages.items():
        is_kept = table["time"] >= 3.0
        second = {key: values[is_kept] for key, values in table.items()}
        is_before_landing = table["time"] < 20.0
        first = {key: values[is_before_landing] for key, values in table.items()}
        second = second | {"time": second["time"] - 3.0, "boot": second["boot"] + 1}
        messages[name] = {key: np.concatenate([first[key], second[key]]) for key in table}
    beat = messages["HEARTBEAT"]
    messages["HEARTBEAT"] = beat | {"base_mode": np.full(len(beat["time"]), ARMED + 1)}
    attitude = messages["ATTITUDE"]
    is_at_rest = is_still & (attitude["boot"] == 1) & (attitude["time"] < 2.6)
    rates = np.where(is_at_rest, 0.0, attitude["rollspeed"])
    messages["ATTITUDE"] = attitude | {"rollspeed": rates}
    (event,) = restart_events(replace(telemetry, messages=messages, restart_delays=delays))
    assert event.code is code
