"""Quantities of the hardware that are a field of some message: load, memory, temperatures, supply, current."""

from dataclasses import replace
from typing import NamedTuple

from mavdem.confidence import Interval
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, recorded_series
from mavdem.ingest.vocabulary import MILLIMETRES_PER_METRE


class QuantitySource(NamedTuple):
    """A field of a message that has a quantity."""

    message: str
    """Name of the message; those of MAVLink's definitions, or of the log where MAVLink has none."""
    field: str
    """Name of the field."""
    scale: float
    """Factor from the field's unit to the quantity's unit."""
    is_only_in_logs: bool = False
    """Whether the field has the quantity only in messages translated from a log; in a stream it has another one."""


class HardwareQuantity(NamedTuple):
    """A quantity, and the fields that have it in different logs."""

    name: str
    """Name of the quantity, for texts and plots."""
    unit: str
    """Its unit."""
    sources: tuple[QuantitySource, ...]
    """Its fields, the preferred first."""
    possible: Interval
    """Values, in its unit, that are possible: others stand for "not known", or are damaged."""
    is_zero_throughout_possible: bool = False
    """Whether a quantity that is 0 in the whole log was measured: most are 0 where nothing measures them."""


BATTERY_CURRENT = HardwareQuantity(
    "battery current", "A", (QuantitySource("SYS_STATUS", "current_battery", 0.01),), (-0.005, 1e4)
)
"""Current of the first battery. MAVLink's common.xml has -1 (-0.01 A) for "not measured"."""

SUPPLY = HardwareQuantity(
    "supply of the autopilot", "V", (QuantitySource("POWER_STATUS", "Vcc", 0.001),), (0.0, 65.0)
)
"""Voltage of the autopilot's supply."""

SERVO_RAIL = HardwareQuantity(
    "servo rail", "V", (QuantitySource("POWER_STATUS", "Vservo", 0.001),), (0.1, 65.0)
)
"""Voltage of the servo rail; about 0 where nothing feeds it."""

PROCESSOR_LOAD = HardwareQuantity(
    "processor load",
    "%",
    (
        QuantitySource("SYS_STATUS", "load", 0.1),
        QuantitySource("PM", "Load", 0.1),
        QuantitySource("cpuload", "load", 100.0),
    ),
    (0.0, 1000.0),
)
"""Load of the processor: of its main loop (ArduPilot), or of all its tasks (PX4)."""

MEMORY_USED = HardwareQuantity(
    "memory used", "%", (QuantitySource("cpuload", "ram_usage", 100.0),), (0.0, 100.0)
)
"""Share of the memory that is used; PX4 logs it."""

MEMORY_FREE = HardwareQuantity(
    "memory free",
    "kB",
    (QuantitySource("MEMINFO", "freemem32", 1 / 1024), QuantitySource("PM", "Mem", 1 / 1024)),
    (0.0, 1e6),
)
"""Memory that is free; ArduPilot reports it."""

PROCESSOR_TEMPERATURE = HardwareQuantity(
    "processor",
    "°C",
    (QuantitySource("MCU_STATUS", "MCU_temperature", 0.01),),
    (-60.0, 200.0),
)
"""Temperature of the processor."""

IMU_TEMPERATURE = HardwareQuantity(
    "IMU",
    "°C",
    (
        QuantitySource("HIGHRES_IMU", "temperature", 1.0, is_only_in_logs=True),
        QuantitySource("SCALED_IMU", "temperature", 0.01),
    ),
    (-60.0, 150.0),
)
"""Temperature of the first IMU. MAVLink's common.xml has 0 in SCALED_IMU for "not measured". In HIGHRES_IMU of a stream
PX4 sends the temperature of the barometer, or of the air (PX4's HIGHRES_IMU.hpp)."""

BAROMETER_TEMPERATURE = HardwareQuantity(
    "barometer",
    "°C",
    (QuantitySource("SCALED_PRESSURE", "temperature", 0.01),),
    (-60.0, 150.0),
)
"""Temperature of the first barometer."""

TEMPERATURES = (PROCESSOR_TEMPERATURE, IMU_TEMPERATURE, BAROMETER_TEMPERATURE)
"""The temperatures other than of the speed controllers."""

HORIZONTAL_ACCURACY = HardwareQuantity(
    "horizontal accuracy",
    "m",
    (QuantitySource("GPS_RAW_INT", "h_acc", 1 / MILLIMETRES_PER_METRE),),
    (1e-4, 1e4),
)
"""Accuracy of the position that the first receiver states."""

VERTICAL_ACCURACY = HardwareQuantity(
    "vertical accuracy",
    "m",
    (QuantitySource("GPS_RAW_INT", "v_acc", 1 / MILLIMETRES_PER_METRE),),
    (1e-4, 1e4),
)
"""Accuracy of the altitude that the first receiver states."""

DILUTION = HardwareQuantity(
    "dilution (HDOP)", "", (QuantitySource("GPS_RAW_INT", "eph", 0.01),), (0.01, 99.0)
)
"""Horizontal dilution of precision of the first receiver; receivers report 99.99 without a position."""

NOISE = HardwareQuantity(
    "noise per ms", "", (QuantitySource("GPS_RAW_INT", "noise_per_ms", 1.0),), (1.0, 1e5)
)
"""Noise that a u-blox receiver measures."""

JAMMING = HardwareQuantity(
    "jamming indicator",
    "",
    (QuantitySource("GPS_RAW_INT", "jamming_indicator", 1.0),),
    (0.0, 255.0),
)
"""u-blox's indicator of jamming, 0 to 255 (UBX-MON-HW, jamInd)."""


def recorded_quantity(signals: Signals, quantity: HardwareQuantity) -> TimeSeries | None:
    """Returns a quantity in its unit from the first of its sources that measures it.

    Impossible values are left out. A source whose possible values are all 0 does not measure the quantity, unless the
    quantity can be 0 throughout a log.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        quantity: the quantity, with its sources in the order of preference.

    Returns:
        The values (N,); None if no source was recorded.
    """
    for source in quantity.sources:
        # Only messages that were translated have a name in their source.
        is_translated = source.message in signals.telemetry.source_names
        if source.is_only_in_logs and not is_translated:
            continue
        series = recorded_series(signals.telemetry, source.message, source.field)
        if series is None:
            continue
        quantity_values = source.scale * series.values
        lowest, highest = quantity.possible
        is_possible = (quantity_values >= lowest) & (quantity_values <= highest)
        is_measured = quantity.is_zero_throughout_possible or quantity_values[is_possible].any()
        if is_measured and is_possible.any():
            return replace(series, values=quantity_values).select(is_possible)
    return None
