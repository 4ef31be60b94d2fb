"""The report of a vehicle's condition: tier, identity, balance, lean, vibration and battery, a sentence each."""

from __future__ import annotations

from math import degrees
from typing import Any

from mavdem.report.blocks import Sentence
from mavdem.report.names import listed
from mavdem.report.rounding import plus_minus, rounded

BASES = {
    "board": "the number of its board",
    "accelerometer": "its accelerometer's calibration",
    "compass": "its compass's calibration",
    "system id": "its system id only, which other vehicles have too",
}
"""What a vehicle's name is made of, in words."""


def identity_sentence(identity: dict[str, Any]) -> Sentence:
    """Which vehicle, by ``Identity.as_dict``."""
    when = f"; {identity['date'][:16].replace('T', ' ')} UTC" if identity["date"] else ""
    what = identity["firmware"] or identity["autopilot"]
    return Sentence(f"{identity['name']}, by {BASES[identity['basis']]}; {what}{when}.", "Vehicle:")


def tier_sentences(tier: dict[str, Any]) -> list[Sentence]:
    """What the log allows and what the next tier needs, by ``Tier.as_dict``."""
    following = tier["next_tier"]
    found = [Sentence(f"{tier['allows']}.", f"Tier {tier['tier']}:")] if tier["tier"] else []
    if following:
        found.append(Sentence(f"tier {following['tier']} needs {following['needs']}.", "Next:"))
    return found


def condition_sentences(condition: dict[str, Any]) -> list[Sentence]:
    """The figures that there are, by ``Condition.as_dict``."""
    found = [_flown(condition)]
    if condition["hover"]:
        found.append(_motors(condition))
    if condition["command"]:
        steady = [_percent(name, one) for name, one in condition["command"].items()]
        found.append(Sentence(f"{listed(steady)} of the motors' range.", "Steady command:"))
    if condition["lean"]:
        lean = [_known(name, one, degrees(1), "°") for name, one in condition["lean"].items()]
        mean, sd, most = (degrees(condition[name]) for name in ("tilt_mean", "tilt_sd", "tilt_max"))
        tilt = f"the angle from level is {mean:.1f}° in the mean, {sd:.1f}° in standard deviation, {most:.1f}° at most"
        found.append(Sentence(f"{listed(lean)}; {tilt}.", "Lean:"))
    if condition["vibration"]:
        found.append(_vibration(condition["vibration"]))
    if condition["battery"]:
        found.append(_battery(condition["battery"], bool(condition["settled"])))
    if condition["hover"]:
        found.append(Sentence("± is the half width of the 90 % interval of a mean of this flight."))
    return found


def _flown(condition: dict[str, Any]) -> Sentence:
    armed = "" if condition["armed"] is None else f", {condition['armed']:.0f} s armed"
    settled = f"{condition['settled']:.0f} s in settled flight"
    return Sentence(f"{condition['duration']:.0f} s{armed}, {settled}.", "Recorded:")


def _motors(condition: dict[str, Any]) -> Sentence:
    hover = condition["hover"]
    shares = [
        f"{name} {_interval(100 * share, None if half is None else 100 * half)} %"
        for name, share, half in zip(hover["motors"], hover["trim_share"], condition["share_interval"], strict=True)
    ]
    limits = [up + low for up, low in zip(hover["at_upper_limit"], hover["at_lower_limit"], strict=True)]
    least, most = (f"{100 * bound(hover['headroom']):.0f}" for bound in (min, max))
    return Sentence(
        f"{listed(shares)} of their mean, which is {100 * condition['collective']:.0f} % of the range; headroom "
        f"{least}{f' to {most}' if most != least else ''} %, at a limit {100 * max(limits):.1f} % of the time at most.",
        "Motors:",
    )


def _vibration(vibration: dict[str, Any]) -> Sentence:
    levels = vibration["level"]
    along = " along x, y and z" if len(levels) == 3 else ""
    clips = f"{vibration['clips']} samples clipped" if vibration["clips"] else "none clipped"
    return Sentence(f"{listed([f'{level:.1f}' for level in levels])} m/s²{along}; {clips}.", "Vibration:")


def _battery(battery: dict[str, Any], flown: bool) -> Sentence:
    text = f"{battery['voltage_start']:.2f} V at the start, {battery['voltage_end']:.2f} V at the end"
    text += f"{' of settled flight' if flown else ' of the log'}, {battery['voltage_min']:.2f} V at least"
    if battery["current_mean"] is not None:
        text += f"; {battery['current_mean']:.1f} A in the mean, {battery['current_max']:.1f} A at most"
    if battery["resistance"] is not None:
        sag = plus_minus(1e3 * battery["resistance"], 1e3 * battery["resistance_interval"])
        text += f"; it sags {sag} mV for each ampere more"
    return Sentence(f"{text}.", "Battery:")


def _percent(name: str, steady: dict[str, Any]) -> str:
    return _known(name, steady, 100.0, " %")


def _known(name: str, steady: dict[str, Any], scale: float, unit: str) -> str:
    half = steady["interval"]
    return f"{name} {_interval(scale * steady['mean'], None if half is None else scale * half)}{unit}"


def _interval(value: float, half: float | None) -> str:
    return rounded(value) if half is None else plus_minus(value, half)
