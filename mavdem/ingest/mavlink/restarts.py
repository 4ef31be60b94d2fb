"""Restarts of an autopilot: those that only its HEARTBEATs show, and how long it was silent before each.

Many messages come only while a program asks for them. After a restart the autopilot then sends nothing with a clock but
HEARTBEATs, the first of them with the state MAV_STATE_BOOT, "System is booting up" (minimal.xml).
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.mavlink.clock_readings import ClockReadings, ReceiveTimes, StreamPositions
from mavdem.ingest.vocabulary import BOOTING

RestartDelays = Mapping[int, float]
"""For each boot but the first, the time, s, from the last message before it to the start of its clock.

By the times of reception; boots for which these are not known are left out. Messages come late by some tenths of a
second, so that a delay may be a little below 0.
"""


class HeartbeatStates(NamedTuple):
    """The n HEARTBEATs of an autopilot."""

    positions: StreamPositions
    """Position of each in the stream (n,), ascending."""
    system_status: NDArray[np.uint8]
    """MAV_STATE that each reports (n,)."""


class Reboot(NamedTuple):
    """The messages with a time on either side of a restart of the autopilot."""

    last_position: int
    """Position in the stream of the last one before."""
    first_position: int
    """Position in the stream of the first one after."""
    first_time: float
    """Time of the first one after, s since boot."""
    boot: int
    """Number of the boot that begins."""


def reboots_of_type(readings: ClockReadings) -> list[Reboot]:
    """Finds the restarts of the autopilot between the messages of one type.

    Args:
        readings: Stream positions, times and boots of the messages of the type.

    Returns:
        The restarts in the order of the stream, each between two successive messages.
    """
    reboots = []
    # A step of the boot number between a row and the next one is a restart.
    for last_row_before in np.flatnonzero(np.diff(readings.boot) > 0).tolist():
        first_row_after = last_row_before + 1
        reboots.append(
            Reboot(
                last_position=int(readings.positions[last_row_before]),
                first_position=int(readings.positions[first_row_after]),
                first_time=float(readings.time[first_row_after]),
                boot=int(readings.boot[first_row_after]),
            )
        )
    return reboots


def heartbeats_after_restarts(
    reference: ClockReadings, heartbeats: HeartbeatStates, receive_times: ReceiveTimes
) -> ClockReadings:
    """Puts the HEARTBEATs of the last boots, in which no message of the reference type came, on the boot clock.

    Such a boot begins, after the last message of the reference, with the first of successive HEARTBEATs that report
    MAV_STATE_BOOT. Its time counts from this HEARTBEAT: the clock of the autopilot, which nothing states, began shortly
    before.

    Args:
        reference: The messages of the reference type on the boot clock, at least one.
        heartbeats: The HEARTBEATs of the same component.
        receive_times: Returns when the messages at some positions were received, s.

    Returns:
        Their positions, times and boots; no row if there is no such boot, or if a time of reception is not known.
    """
    is_booting = heartbeats.system_status == BOOTING
    was_booting = np.concatenate([[False], is_booting[:-1]])
    is_after_reference = heartbeats.positions > reference.positions[-1]
    is_first_of_boot = is_booting & ~was_booting & is_after_reference
    restart_count = np.cumsum(is_first_of_boot)
    is_after_restart = restart_count > 0
    positions = heartbeats.positions[is_after_restart]
    received = receive_times(positions)
    if np.isnan(received).any():
        return reference.select(slice(0, 0))
    starts_of_boots = received[is_first_of_boot[is_after_restart]]
    boots_after_reference = restart_count[is_after_restart]
    return ClockReadings(
        positions,
        time=received - starts_of_boots[boots_after_reference - 1],
        boot=reference.boot[-1] + boots_after_reference,
    )


def restart_delays(reference: ClockReadings, receive_times: ReceiveTimes) -> RestartDelays:
    """Returns how long an autopilot was silent at each restart, until its clock started anew.

    Args:
        reference: The messages that define the boot clock, in the order of the stream.
        receive_times: Returns when the messages at some positions were received, s.

    Returns:
        By number of the boot, such as 1 for the first restart, the silence before it, s. Boots without times of
        reception are left out.
    """
    delays = {}
    for reboot in reboots_of_type(reference):
        received_before, received_after = receive_times(
            np.array([reboot.last_position, reboot.first_position])
        )
        start_of_clock = received_after - reboot.first_time
        delay = float(start_of_clock - received_before)
        if np.isfinite(delay):
            delays[reboot.boot] = delay
    return delays
