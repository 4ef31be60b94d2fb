"""The boot clock of a live vehicle: which falls of it are reboots, as in a log."""

import numpy as np
from mavlink_streams import read, stamped_flight
from pytest import approx, mark

from mavdem.facts.session import VehicleFact
from mavdem.live.boot_clock import BootClock
from mavdem.live.messages import Message

STEP = 0.02


def clock(start, end, reception):
    """Attitude stamps and times of reception, s, without a pause."""
    count = round((end - start) / STEP)
    return [(start + STEP * row, reception + STEP * row) for row in range(count)]


def live_facts(*parts):
    """Returns what a live session reports about the boot clock, and the number of boots that it finds.

    A part is a list of pairs: the stamp of a message, s since boot, and the time when it was received, s.
    """
    facts = []
    boot_clock = BootClock(facts.append)
    for stamp, reception in [entry for part in parts for entry in part]:
        boot_clock.place(Message("ATTITUDE", stamp, np.inf, ()), reception)
    return facts, boot_clock.boot + 1


def boots_in_log(*parts):
    """Number of boots in a telemetry log with these attitudes."""
    vehicle = read(stamped_flight([entry for part in parts for entry in part])).vehicles[0]
    return len(np.unique(vehicle.messages["ATTITUDE"]["boot"]))


@mark.slow
@mark.parametrize("first_duration", [2.5, 5.0, 9.0, 15.0])
@mark.parametrize("restart", [0.5, 1.0])
def test_a_reboot_soon_after_the_start_is_announced(first_duration, restart):
    """The clock of an autopilot runs for some seconds, and begins again at 0.5 or 1 s."""
    parts = [clock(1.0, 1.0 + first_duration, 0.0), clock(restart, 30.0, first_duration + 1.0)]
    facts, boots = live_facts(*parts)
    assert [fact.code for fact in facts] == [VehicleFact.VEHICLE_REBOOTED]
    assert facts[0].figures["clock"] == approx(1.0 + first_duration, abs=0.05)
    assert boots == boots_in_log(*parts) == 2


@mark.parametrize("share", [0.05, 0.2])
def test_messages_that_only_a_late_link_brought_are_no_reboot(share):
    """A second link brings the messages that the first one lost, 3 s late.

    Their stamps are before those of newer ones.
    """
    first = clock(1.0, 9.0, 0.0)
    is_lost = np.random.default_rng(5).random(len(first)) < share
    late = [(stamp, reception + 3.0) for stamp, reception in np.array(first)[is_lost].tolist()]
    arrived = sorted([*np.array(first)[~is_lost].tolist(), *late], key=lambda entry: entry[1])
    facts, boots = live_facts(arrived)
    assert (facts, boots) == ([], 1)
    assert boots_in_log(arrived) == 1


def test_a_clock_that_falls_without_a_pause_and_not_to_zero_is_no_reboot():
    facts, _ = live_facts(clock(400.0, 440.0, 0.0), clock(250.0, 270.0, 40.0))
    assert [fact.code for fact in facts] == [VehicleFact.CLOCK_WENT_BACK]


def test_a_reboot_while_nothing_was_received_is_announced():
    facts, boots = live_facts(clock(400.0, 440.0, 0.0), clock(250.0, 270.0, 320.0))
    assert [fact.code for fact in facts] == [VehicleFact.VEHICLE_REBOOTED]
    assert boots == 2


@mark.parametrize("uptime", [4.9, 15.0])
@mark.parametrize("gap", [3.0, 10.0, 30.0])
def test_a_reboot_in_a_silence_is_announced_by_its_first_attitudes(uptime, gap):
    parts = [clock(0.0, uptime, 0.0), clock(0.02, 0.2, uptime + gap)]
    facts, boots = live_facts(*parts)
    assert [fact.code for fact in facts] == [VehicleFact.VEHICLE_REBOOTED]
    assert boots == boots_in_log(*parts) == 2
