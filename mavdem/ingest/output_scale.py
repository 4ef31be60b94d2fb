"""Scale of motor outputs: the unit of the numbers in a log, and which of them mean no throttle and full throttle.

Autopilots log pulse widths, DShot or UAVCAN commands, or fractions of the range, and rarely say which. The scale
follows from the values themselves and from the parameters of the output driver.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.ingest.motors import OutputDriver
from mavdem.ingest.telemetry import Parameters

UNKNOWN_SCALE = "unknown"
"""Name of the scale of outputs whose range is not known; their largest value is used as its upper end."""


@dataclass(frozen=True)
class OutputScale:
    """How motor outputs are expressed."""

    name: str
    """"PWM", "normalised", "0-1000", "DShot", "UAVCAN" or "unknown"; "demand" for a controller's demand."""
    unit: str
    """"µs" for pulse widths, else empty."""
    low: float
    """Output at no throttle."""
    high: float
    """Output at full throttle."""
    step: float
    """Smallest difference between two values that occurred; 0 where all are equal."""
    upper_limit: float = 1.0
    """Highest output that the autopilot sends to a motor, as a fraction of the range, 0 to 1; 1 where it is not
    known."""
    lower_limit: float = 0.0
    """Lowest output that it sends to a motor in flight, as a fraction of the range, 0 to 1: the idle in the air."""

    def fraction(self, outputs: Array) -> Array:
        """Converts outputs to fractions of the range.

        Args:
            outputs: Outputs of any shape, in the unit of the scale.

        Returns:
            Fractions of the same shape: 0 at ``low`` and for a motor that is off (an output of 0), 1 at ``high``. Some
            autopilots send less than ``low`` while disarmed; those fractions are negative.
        """
        # Computed in place, since copies of hours of flight take much memory.
        fractions = np.asarray(outputs - self.low, np.float64)
        fractions /= self.high - self.low
        if self.low > 0:
            np.copyto(fractions, 0.0, where=outputs == 0)
        return fractions


MAX_NORMALISED = 1.05
"""Largest output of a scale of 0 to 1, with a margin for overshoot."""

MAX_IDLE_DSHOT = 10.0
"""Outputs up to this one, and above ``MAX_NORMALISED``, are DShot commands hardly above idle."""

PER_MILLE = 1000.0
"""Unit of THR_MIN: a thousandth of the range."""

SIMULATOR_FULL_THROTTLE = 1000.0
"""Full throttle of PX4's simulators, which send 150 to 1000."""

MAX_DSHOT_COMMAND = 2047.0
"""Largest command of DShot: it has 11 bits."""

MAX_DSHOT = 1999.0
"""DShot output of PX4 at full throttle: DSHOT_MAX_THROTTLE of its ``DShot.h``, without the 48 special commands."""

DSHOT_FULL_THROTTLE = 2000.0
"""Full throttle of DShot where no parameter has it, rounded."""

UAVCAN_FULL_THROTTLE = 8191.0
"""Output of PX4 at full throttle for UAVCAN's esc.RawCommand, which has 14 bits and a sign."""

MIN_PULSE_WIDTH = 750.0
"""Pulse widths of motors, µs, never fall below this one, except to 0 for "off"; PX4 sends 900 while disarmed."""

MAX_PULSE_WIDTH = 2300.0
"""Longest pulse width of a motor, µs: a choice, above those that speed controllers take for full throttle."""

MIN_RUNNING_PULSE_WIDTH = 1000.0
"""At least one pulse width, µs, is above this one if motors ran."""

MIN_PULSE_RANGE = 300.0
"""Smallest range of pulse widths of a speed controller, µs; parameters with less are of something else."""

MAX_FRACTION_OUTSIDE = 0.5
"""Fraction of the distinct outputs that may lie outside the range of the parameters for them to be of this driver.

Outputs of disarmed and arming motors lie outside, and damaged ones.
"""

DEFAULT_PULSE_RANGE = (1000.0, 2000.0)
"""Pulse widths at no and at full throttle, µs, where no parameter has them (ArduPilot's and PX4's defaults)."""


def output_scale(
    outputs: Array, parameters: Parameters, drivers: Sequence[OutputDriver] = ()
) -> OutputScale:
    """Recognises the scale of motor outputs, such as pulse widths in µs or DShot commands, which no message states.

    Scales differ in their largest output, and pulse widths also in their smallest one above 0. The candidates, from the
    most to the least specific, are the range that PX4's parameters give an output driver, pulse widths, and DShot with
    the idle throttle of PX4's parameters. If none of them fits, the largest output alone decides.

    Args:
        outputs: Outputs of any shape, as they were sent, also while disarmed; values that are not finite are ignored.
        parameters: The autopilot's parameters by name.
        drivers: PX4's output driver of each motor (``MotorGeometry.drivers``); empty for other autopilots.

    Returns:
        The scale. If none fits, its name is "unknown", and its range is 0 to the largest output.
    """
    distinct_outputs = np.unique(outputs[np.isfinite(outputs)])
    positive_outputs = distinct_outputs[distinct_outputs > 0]
    if not len(positive_outputs):
        return OutputScale(UNKNOWN_SCALE, "", low=0.0, high=1.0, step=0.0)
    step = float(np.diff(distinct_outputs).min()) if len(distinct_outputs) > 1 else 0.0
    smallest_output = float(positive_outputs[0])
    largest_output = float(positive_outputs[-1])
    is_px4 = bool(drivers)
    driver = drivers[0].name if is_px4 else ""
    px4_low, px4_high = _px4_range(drivers, parameters)
    is_in_px4_range = MAX_NORMALISED < largest_output <= px4_high
    if is_in_px4_range and not driver.startswith("PWM"):
        name = "UAVCAN" if driver.startswith("UAVCAN") else "0-1000"
        return OutputScale(name, "", px4_low, px4_high, step)
    has_running_motor = MIN_RUNNING_PULSE_WIDTH < largest_output <= MAX_PULSE_WIDTH
    if smallest_output >= MIN_PULSE_WIDTH and has_running_motor:
        return _pulse_width_scale(positive_outputs, step, parameters, drivers)
    may_be_dshot = MAX_IDLE_DSHOT < largest_output <= MAX_DSHOT_COMMAND
    if is_px4 and may_be_dshot and "DSHOT_MIN" in parameters:
        # DSHOT_MIN is the idle throttle as a fraction of the range, 0 to 1, so that the lower end is at idle.
        low = float(round(parameters["DSHOT_MIN"] * MAX_DSHOT))
        return OutputScale("DShot", "", low, MAX_DSHOT, step)
    name, high = _scale_of_largest(largest_output, is_px4=is_px4)
    return OutputScale(name, "", low=0.0, high=high, step=step)


def _pulse_width_scale(
    pulse_widths: Array, step: float, parameters: Parameters, drivers: Sequence[OutputDriver]
) -> OutputScale:
    """Returns the scale of pulse widths, with the limits that the autopilot sets to the motors.

    Args:
        pulse_widths: Distinct outputs (N,) above 0, µs.
        step: Smallest difference between two of them, µs.
        parameters: The autopilot's parameters by name.
        drivers: PX4's output driver of each motor; empty for ArduPilot.
    """
    low, high = _pulse_range(pulse_widths, parameters, drivers)
    upper_limit = _ardupilot_upper_limit(parameters)
    # PX4's range begins at the output of an idling motor, so that the lower limit is the lower end of the range.
    lower_limit = 0.0 if drivers else _ardupilot_lower_limit(parameters)
    return OutputScale("PWM", "µs", low, high, step, upper_limit, lower_limit)


def _scale_of_largest(largest_output: float, *, is_px4: bool) -> tuple[str, float]:
    """Chooses a scale of motor outputs by the largest output alone: the first one whose range contains it.

    The ranges are tried from the smallest to the largest. DShot commands occur in two of them: a vehicle that only
    idled sends the first few commands, one that flew sends more than the 1000 of PX4's simulators.

    Args:
        largest_output: Largest output of any motor that occurred.
        is_px4: Whether the autopilot is PX4, which alone logs commands of UAVCAN.

    Returns:
        Name of the scale and its output at full throttle; "unknown" and the largest output where it exceeds all.
    """
    if largest_output <= MAX_NORMALISED:
        return "normalised", 1.0
    if largest_output <= MAX_IDLE_DSHOT:
        return "DShot", DSHOT_FULL_THROTTLE
    if largest_output <= SIMULATOR_FULL_THROTTLE:
        return "0-1000", SIMULATOR_FULL_THROTTLE
    if largest_output <= MAX_DSHOT_COMMAND:
        return "DShot", DSHOT_FULL_THROTTLE
    if is_px4 and largest_output <= UAVCAN_FULL_THROTTLE:
        return "UAVCAN", UAVCAN_FULL_THROTTLE
    return UNKNOWN_SCALE, largest_output


def _pulse_range(
    pulse_widths: Array, parameters: Parameters, drivers: Sequence[OutputDriver]
) -> Interval:
    """Returns the pulse widths at no and at full throttle, µs: the first range in the parameters that fits the outputs.

    If no range fits, it is the autopilot's default. For pulses of PX4 above the default, it ends at the longest
    possible pulse.

    Args:
        pulse_widths: Distinct outputs (N,) above 0, µs.
        parameters: The autopilot's parameters by name.
        drivers: PX4's output driver of each motor; empty for ArduPilot.

    Returns:
        Pulse widths at no throttle and at full throttle, µs.
    """
    if drivers:
        ranges = [_px4_range(drivers, parameters)]
    else:
        ranges = _ardupilot_ranges(parameters)
    for lower_end, upper_end in ranges:
        is_pulse_range = lower_end > 0 and upper_end - lower_end >= MIN_PULSE_RANGE
        # One microsecond above the range is rounding.
        is_outside = (pulse_widths < lower_end) | (pulse_widths > upper_end + 1)
        if is_pulse_range and np.mean(is_outside) <= MAX_FRACTION_OUTSIDE:
            return lower_end, upper_end
    lower_end, upper_end = DEFAULT_PULSE_RANGE
    if drivers and pulse_widths.max() > upper_end + 1:
        # The range was changed from PX4's default, and nothing shows its upper end.
        return lower_end, MAX_PULSE_WIDTH
    return lower_end, upper_end


def _ardupilot_ranges(parameters: Parameters) -> list[Interval]:
    """Returns the ranges of pulse widths, µs, that ArduPilot's parameters may give the motors, the likeliest first.

    It is set by MOT_PWM_MIN and MOT_PWM_MAX. If these are 0, and in ArduCopter before 3.4, which has neither, it is the
    range of the radio's throttle channel. Before 3.3 that is always channel 3, also if RCMAP_THROTTLE assigns the stick
    to another: the motors are constructed from ``g.rc_3`` (``ArduCopter.pde``).

    Args:
        parameters: The autopilot's parameters by name.

    Returns:
        Lower and upper end of each range; 0 where a parameter is missing.
    """
    prefixes = ["MOT_PWM"]
    is_before_3_3 = "MOT_TCRV_ENABLE" in parameters
    if is_before_3_3:
        prefixes.append("RC3")
    elif "RCMAP_THROTTLE" in parameters:
        prefixes.append(f"RC{parameters['RCMAP_THROTTLE']:.0f}")
    return [
        (parameters.get(f"{prefix}_MIN", 0.0), parameters.get(f"{prefix}_MAX", 0.0))
        for prefix in prefixes
    ]


def _px4_range(drivers: Sequence[OutputDriver], parameters: Parameters) -> Interval:
    """Looks up PX4's outputs at no and at full throttle, as means over the motors.

    Args:
        drivers: PX4's output driver of each motor.
        parameters: The autopilot's parameters by name.

    Returns:
        Both outputs; 0 and 0 if the range of a motor is not known or there are no drivers.
    """
    lower_ends = [_px4_limit(driver, "MIN", parameters) for driver in drivers]
    upper_ends = [_px4_limit(driver, "MAX", parameters) for driver in drivers]
    is_any_unknown = 0.0 in lower_ends or 0.0 in upper_ends
    if not drivers or is_any_unknown:
        return 0.0, 0.0
    return float(np.mean(lower_ends)), float(np.mean(upper_ends))


def _px4_limit(driver: OutputDriver, end: str, parameters: Parameters) -> float:
    """Returns one end, "MIN" or "MAX", of the range of one of PX4's outputs.

    Since PX4 1.13 each output has a parameter (PWM_MAIN_MIN1), where -1 means that the driver's applies. The driver's
    is PWM_MAIN_MIN in PX4 1.12; before, there is only PWM_MIN, for the main outputs.

    Args:
        driver: Driver and number of the output.
        end: "MIN" or "MAX".
        parameters: The autopilot's parameters by name.

    Returns:
        The output; 0 if no parameter has it.
    """
    names = [f"{driver.name}_{end}{driver.channel}", f"{driver.name}_{end}"]
    if driver.name == "PWM_MAIN":
        names.append(f"PWM_{end}")
    for name in names:
        if parameters.get(name, 0.0) > 0:
            return parameters[name]
    return 0.0


MIN_UPPER_LIMIT = 0.5
"""Smallest fraction of the range that counts as the mixer's limit; a parameter with less has another meaning."""


def _ardupilot_upper_limit(parameters: Parameters) -> float:
    """Returns the upper limit that ArduPilot's mixer sets to the motors, as a fraction of the range of their outputs.

    From ArduCopter 3.4 on it is MOT_SPIN_MAX. In 3.3 it is MOT_THST_MAX, a fraction of the range above THR_MIN, which
    is in per mille. Before, it is MOT_TCRV_MAXPCT, in percent. Source: ``AP_MotorsMulticopter`` and, before it,
    ``AP_Motors`` of https://github.com/ArduPilot/ardupilot.

    Args:
        parameters: The autopilot's parameters by name.

    Returns:
        The fraction, 0.5 to 1; 1 without such a parameter.
    """
    upper_limit = 1.0
    if "MOT_SPIN_MAX" in parameters:
        upper_limit = parameters["MOT_SPIN_MAX"]
    elif "MOT_THST_MAX" in parameters:
        idle_fraction = parameters.get("THR_MIN", 0.0) / PER_MILLE
        upper_limit = idle_fraction + (1 - idle_fraction) * parameters["MOT_THST_MAX"]
    elif parameters.get("MOT_TCRV_ENABLE"):
        upper_limit = parameters.get("MOT_TCRV_MAXPCT", 100.0) / 100
    return upper_limit if MIN_UPPER_LIMIT <= upper_limit <= 1 else 1.0


DEFAULT_LOWER_LIMIT = 0.15
"""Fraction of the range at which ArduPilot's motors idle in flight where no parameter has it: MOT_SPIN_MIN's
default."""


def _ardupilot_lower_limit(parameters: Parameters) -> float:
    """Looks up the output at which ArduPilot's motors idle in flight.

    The parameter is MOT_SPIN_MIN from ArduCopter 3.4 on, and THR_MIN, per mille of the range, before.

    Args:
        parameters: The autopilot's parameters by name.

    Returns:
        The fraction of the output's range, 0 to 1; the firmware's default if no parameter has it.
    """
    if "MOT_SPIN_MIN" in parameters:
        return parameters["MOT_SPIN_MIN"]
    if "THR_MIN" in parameters:
        return parameters["THR_MIN"] / PER_MILLE
    return DEFAULT_LOWER_LIMIT
