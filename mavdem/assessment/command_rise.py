"""How much harder all motors had to work at the end of a flight than at its beginning, as when a battery empties.

Thrust depends on the product of command and voltage, so that the command that holds a vehicle rises as the voltage
falls. It shows an empty battery even where no voltage was measured.
"""

from typing import NamedTuple

import numpy as np

from mavdem.assessment.flights import settled_flight
from mavdem.dataset.segments import in_segments
from mavdem.dataset.signals import Signals

COMMAND_AVERAGING_SECONDS = 10.0
"""Duration of settled flight, s, at its beginning and end over which the commands are averaged: gusts last less."""

MIN_RELATIVE_RISE = 0.1
"""Rise of the command, as a fraction, that is stated: a voltage that falls from 4.2 to 3.8 V a cell makes as much."""


class CommandRise(NamedTuple):
    """Mean commands of all motors in settled flight, as fractions of their range."""

    first_command: float
    """At its beginning."""
    last_command: float
    """At its end."""


def command_rise(signals: Signals, boot: int, end_time: float) -> CommandRise | None:
    """Returns how much the mean command of all motors rose in settled flight.

    Settled flight is flight away from the ground without manoeuvres.

    Args:
        signals: logged time series of the vehicle, with the outputs of its motors.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        end_time: time from which on the flight does not count, s since boot.

    Returns:
        The rise; None if it is less than ``MIN_RELATIVE_RISE``, or if the settled flight is too short for two separate
        averages.
    """
    commands = signals.collective
    if commands is None:
        return None
    is_settled = in_segments(commands, *settled_flight(signals))
    is_before = (commands.boot == boot) & (commands.time < end_time)
    time = commands.time[is_settled & is_before]
    values = commands.values[is_settled & is_before]
    if len(time) == 0 or time[-1] - time[0] < 2 * COMMAND_AVERAGING_SECONDS:
        return None
    first_command = float(np.mean(values[time < time[0] + COMMAND_AVERAGING_SECONDS]))
    last_command = float(np.mean(values[time > time[-1] - COMMAND_AVERAGING_SECONDS]))
    if last_command < (1 + MIN_RELATIVE_RISE) * first_command:
        return None
    return CommandRise(first_command, last_command)
