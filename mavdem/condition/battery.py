"""Battery: voltage and current, and how far the voltage sags with the load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment.columns import floats, in_order
from mavdem.alignment.signals import Signals
from mavdem.condition.mean_interval import mean_interval
from mavdem.condition.periods import Periods, during

END_SECONDS = 2.0  # The voltage at either end is the median over so long


@dataclass(frozen=True)
class BatteryFigures:
    """The first battery over some time; V, A and Ω. None where it was not measured.

    Attributes:
        voltage_start, voltage_end: medians of the first and the last 2 s.
        voltage_mean, voltage_min: of all samples.
        current_mean, current_max: of all samples.
        resistance: how far the voltage falls with each ampere, apart from the steady discharge; None where the current
            hardly changed, so that the interval contains 0.
        resistance_interval: half width of its 90 % interval.
    """

    voltage_start: float
    voltage_end: float
    voltage_mean: float
    voltage_min: float
    current_mean: float | None = None
    current_max: float | None = None
    resistance: float | None = None
    resistance_interval: float | None = None


def battery_of(signals: Signals, periods: Periods) -> BatteryFigures | None:
    """The battery during some periods; None where no voltage was measured then."""
    voltage = signals.voltage
    if voltage is None:
        return None
    here = during(periods, voltage.time, voltage.boot)
    time, boot, volts = voltage.time[here], voltage.boot[here], voltage.values[here]
    if not len(volts):
        return None
    first, last = (
        (boot == boot[0]) & (time <= time[0] + END_SECONDS),
        (boot == boot[-1]) & (time >= time[-1] - END_SECONDS),
    )
    figures = float(np.median(volts[first])), float(np.median(volts[last])), float(volts.mean()), float(volts.min())
    measured = _volts_and_amperes(signals, periods)
    if measured is None:
        return BatteryFigures(*figures)
    seconds, volts, amperes = measured
    load = float(amperes.mean()), float(amperes.max())
    return BatteryFigures(*figures, *load, *_resistance(seconds, volts, amperes))


def _volts_and_amperes(signals: Signals, periods: Periods) -> tuple[NDArray[np.float64], ...] | None:
    """Time, voltage and current (N,) of SYS_STATUS, which has both; None where there is no current."""
    columns = signals.telemetry.messages.get("SYS_STATUS")
    if columns is None or "current_battery" not in columns:
        return None
    table = np.column_stack([floats(columns, "voltage_battery") / 1e3, floats(columns, "current_battery") / 1e2])
    time, boot, table, _ = in_order(columns["time"], columns["boot"], table)
    here = during(periods, time, boot)
    volts, amperes = table[here].T
    # A negative current stands for none, and a sensor that is not there, or not calibrated, reads 0 at times.
    return (time[here], volts, amperes) if len(amperes) and amperes.min() > 0 else None


def _resistance(
    time: NDArray[np.float64], volts: NDArray[np.float64], amperes: NDArray[np.float64]
) -> tuple[float | None, float | None]:
    """Resistance and half width: regression on the current, both without their straight line over time."""
    if len(time) < 10:
        return None, None
    line = np.column_stack([np.ones_like(time), time - time.mean()])
    fallen, load = (column - line @ np.linalg.lstsq(line, column, rcond=None)[0] for column in (-volts, amperes))
    power = float(load @ load)
    if power <= 0:
        return None, None
    resistance = float(load @ fallen) / power
    scores = load * (fallen - resistance * load) * len(load) / power
    half = float(mean_interval(scores[:, None], float(np.ptp(time))).half_width[0])
    return (resistance, half) if 0 < half < resistance else (None, None)
