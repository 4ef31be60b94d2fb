"""The wind of a log in m/s, beside the autopilot's own estimate, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mavdem.report.blocks import Block, Sentence
from mavdem.report.numbers import from_point


def wind_blocks(wind: Mapping[str, Any] | None, reason: str = "") -> list[Block]:
    """Returns speed and direction of ``WindVelocity.as_dict()``, or the ``reason`` why not; and the autopilot's own."""
    if wind is None:
        return [Sentence(reason, "Wind:")]
    low, high = wind["speed_interval"]
    text = f"below {high:.1f} m/s" if wind["calm"] else f"{wind['speed']:.1f} m/s ({low:.1f} to {high:.1f})"
    if not wind["calm"] and wind["status"]["direction"] != "not identifiable":
        text += f" from {from_point(wind['direction'])}, ± {wind['direction_interval']:.0f}°"
    text += f"; gusts up to {wind['gust']:.1f} m/s over 3 s. Intervals hold the mean with 90 %."
    if own := wind.get("autopilot"):
        off = f"{own['speed_difference']:+.1f} m/s, {own['direction_difference']:+.0f}°"
        off = f" from {from_point(own['direction'])}: {off}" if own["speed"] > 0.05 else ""
        text += f" The autopilot's own estimate is {own['speed']:.1f} m/s{off}."
    return [Sentence(text, "Wind:"), *(Sentence(why, f"Wind's {what}:") for what, why in wind["reasons"].items())]
