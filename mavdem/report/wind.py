"""The wind of a log in m/s, beside the autopilot's own estimate, in words."""

from __future__ import annotations

import numpy as np

from mavdem.alignment.drive import Signal
from mavdem.alignment.signals import Signals
from mavdem.condition import WindVelocity, wind_of
from mavdem.condition.wind_velocity import coming_from
from mavdem.errors import NotLearnable
from mavdem.report.blocks import Block, Sentence
from mavdem.report.numbers import from_point

Air = tuple[WindVelocity | None, Signal | None, str]  # the wind, the autopilot's own estimate, and why there is no wind


def air_of(signals: Signals) -> Air:
    """Returns what a vehicle's ``signals`` say of the wind."""
    try:
        return wind_of(signals), signals.autopilot_wind, ""
    except NotLearnable as error:
        return None, None, str(error)


def wind_blocks(air: Air) -> list[Block]:
    """Returns speed and direction with intervals, what is not reported, and how far the autopilot's own is off."""
    wind, own, reason = air
    if wind is None:
        return [Sentence(reason, "Wind:")]
    low, high = wind.speed_interval
    text = f"below {high:.1f} m/s" if wind.calm else f"{wind.speed:.1f} m/s ({low:.1f} to {high:.1f})"
    if not wind.calm and wind.status["direction"] != "not identifiable":
        text += f" from {from_point(wind.direction)}, ± {wind.direction_interval:.0f}°"
    text += f"; gusts up to {wind.gust:.1f} m/s over 3 s. Intervals hold the mean with 90 %."
    if own is not None and (rows := (own.time >= wind.time[0]) & (own.time <= wind.time[-1])).any():
        mean = own.values[rows].mean(axis=0)
        speed, angle = np.hypot(*mean), coming_from(*mean)
        apart = f"{speed - wind.speed:+.1f} m/s, {(angle - wind.direction + 180) % 360 - 180:+.0f}°"
        off = f" from {from_point(angle)}: {apart}" if speed > 0.05 else ""
        text += f" The autopilot's own estimate is {speed:.1f} m/s{off}."
    return [Sentence(text, "Wind:"), *(Sentence(why, f"Wind's {what}:") for what, why in wind.reasons.items())]
