"""MCAP channels of a flight: its measurements, and the results of its model, for viewers such as Foxglove."""

import re
from collections.abc import Sequence

from mavdem.dem import Learned
from mavdem.experiments.held_out import HeldOut
from mavdem.files import PathName, atomic_write
from mavdem.flight import Flights
from mavdem.ingest.mcap.series import write_series
from mavdem.report.numbers import without_remark
from mavdem.report.series import recording_series
from mavdem.wind_velocity.velocity import WindVelocity


def write_channels(
    path: PathName,
    flights: Flights,
    learned: Learned | None = None,
    held_out: HeldOut | None = None,
    wind: WindVelocity | None = None,
) -> None:
    """Writes flights of one boot as JSON channels of an .mcap file, on the boot clock, in the units of the flight.

    The channels, of which ``docs/layouts`` has a layout for Foxglove and one for PlotJuggler:

    - ``flight/outputs`` and ``flight/inputs``: what was measured;
    - with ``learned``: ``learned/one_step``; ``learned/process_noise``, per second; ``learned/free_energy``, F(t);
      ``learned/free_energy_terms``, its terms; ``learned/free_energy_action``, its sum up to each sample, nats;
      ``learned/command``, the motors' difference; and where it is known ``learned/wind_torque``, rad/s², with the half
      width of its band;
    - with ``held_out``: ``held_out/measured``, ``held_out/forecast``, ``held_out/residual`` and ``held_out/band``, the
      half width of the forecast's 90 % band;
    - with ``wind``: ``wind/velocity``, the north and east velocity of the air, m/s, and ``wind/band``, half widths.

    Args:
        path: path of the file to write.
        flights: at least one.
        learned: the model of these ``flights``.
        held_out: forecasts of windows of these ``flights``.
        wind: the wind velocity of the same boot.

    Raises:
        OSError: ``path`` cannot be written.
        ValueError: a time is negative, which MCAP cannot hold, or ``learned`` is the model of other flights.
    """
    if flights[0].time[0] < 0:
        raise ValueError("time must not be negative: MCAP counts from 0")
    channels = {}
    for name, series in recording_series(flights, learned, held_out, wind).items():
        keys = json_keys(series.names)
        channels[name] = (series.time, dict(zip(keys, series.values.T, strict=True)))
    with atomic_write(path) as file:
        write_series(file, channels)


def json_keys(names: Sequence[str]) -> list[str]:
    """Returns names of signals as JSON keys that viewers accept in paths: "motor_1" for "motor 1 (front right)".

    Characters other than letters, digits and underscores would need quotes there. If two names would become the same
    key, all get a number at their end.

    Args:
        names: names of signals, all different.

    Returns:
        One key for each name, in the same order; no two are the same.
    """
    keys = [re.sub(r"\W+", "_", without_remark(name)).strip("_") for name in names]
    if len(set(keys)) < len(keys):
        return [f"{key}_{number}" for number, key in enumerate(keys, 1)]
    return keys
