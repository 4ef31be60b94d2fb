"""The condition of a vehicle, which a log has at any rate, and the contents of the log, in sentences and tables."""

from __future__ import annotations

from math import degrees
from typing import Any

import numpy as np

from mavdem.alignment.drive import TILT_AXES
from mavdem.condition.wind_of_log import Air
from mavdem.condition.wind_velocity import WindVelocity, coming_from, from_point
from mavdem.facts.assessment import Override
from mavdem.facts.identifiability import Status
from mavdem.ingest.vocabulary import UNNAMED
from mavdem.report.blocks import Block, Sentence, Table, caution
from mavdem.report.numbers import listed, plus_minus, rounded

# what a tier is called where it is shown
TIER_WORDS = {"a": "full model", "b": "slow motion", "c": "condition only"}
BASES = {  # what a vehicle's name is made of, in words
    "board": "the number of its board",
    "accelerometer": "its accelerometer's calibration",
    "compass": "its compass's calibration",
    "system id": "its system id only, which other vehicles have too",
}
# messages below this rate are listed together: they are too slow to describe the motion
SLOW_HZ = 0.95
MOST_ALARMS = 5  # of the autopilot that are shown
UNWATCHED = (
    "a motor that weakens would not be seen: the motor outputs come too seldom, or "
    "the motors' places are not known."
)
# share of missing sequence numbers from which it is reported; less is a radio link in good order
MIN_LOST_SHARE = 0.01


def identity_sentence(identity: dict[str, Any]) -> Sentence:
    """Returns which vehicle it is, by ``Identity.as_dict``."""
    when = f"; {identity['date'][:16].replace('T', ' ')} UTC" if identity["date"] else ""
    what = identity["firmware"] or identity["autopilot"]
    return Sentence(f"{identity['name']}, by {BASES[identity['basis']]}; {what}{when}.", "Vehicle:")


def tier_sentences(tier: dict[str, Any]) -> list[Sentence]:
    """Returns what the log allows, by ``Tier.as_dict``; what the next ``tier`` needs, the findings say."""
    name = tier["tier"]
    return (
        [Sentence(f"{tier['allows']}.", f"{TIER_WORDS[name].capitalize()} (tier {name}):")]
        if name
        else []
    )


def condition_sentences(condition: dict[str, Any]) -> list[Sentence]:
    """Returns the figures of a ``condition`` that there are, by ``Condition.as_dict``."""
    armed = "" if condition["armed"] is None else f", {condition['armed']:.0f} s armed"
    text = f"{condition['duration']:.0f} s{armed}, {condition['settled']:.0f} s in settled flight."
    sentences = [Sentence(text, "Recorded:")]
    if hover := condition["hover"]:
        known = zip(hover["motors"], hover["trim_share"], condition["share_interval"], strict=True)
        shares = listed(f"{name} {_interval(share, half)}" for name, share, half in known)
        limit = max(
            up + low
            for up, low in zip(hover["at_upper_limit"], hover["at_lower_limit"], strict=True)
        )
        least, best = (f"{100 * bound(hover['headroom']):.0f}" for bound in (min, max))
        text = f"{shares} of their mean, which is {100 * condition['collective']:.0f} % of the range; headroom {least}"
        text += f"{f' to {best}' if best != least else ''} %, at a limit {100 * limit:.1f} % of the time at most."
        sentences.append(Sentence(text, "Motors:"))
    if condition["command"]:
        steady = [
            f"{name} {_interval(one['mean'], one['interval'])}"
            for name, one in condition["command"].items()
        ]
        sentences.append(Sentence(f"{listed(steady)} of the motors' range.", "Steady command:"))
    if condition["lean"]:
        means = condition["lean"].items()
        lean = [
            f"{name} {_interval(one['mean'], one['interval'], degrees(1), '°')}"
            for name, one in means
        ]
        mean, sd, most = (degrees(condition[name]) for name in ("tilt_mean", "tilt_sd", "tilt_max"))
        tilt = f"the angle from level is {mean:.1f}° in the mean, {sd:.1f}° in standard deviation, {most:.1f}° at most"
        sentences.append(Sentence(f"{listed(lean)}; {tilt}.", "Lean:"))
    if vibration := condition["vibration"]:
        levels = vibration["level"]
        along = " along x, y and z" if len(levels) == 3 else ""
        clips = f"{vibration['clips']} samples clipped" if vibration["clips"] else "none clipped"
        sentences.append(
            Sentence(
                f"{listed(f'{level:.1f}' for level in levels)} m/s²{along}; {clips}.", "Vibration:"
            )
        )
    if battery := condition["battery"]:
        text = f"{battery['voltage_start']:.2f} V at the start, {battery['voltage_end']:.2f} V at the end of "
        text += f"{'settled flight' if condition['settled'] else 'the log'}, {battery['voltage_min']:.2f} V at least"
        if battery["current_mean"] is not None:
            text += f"; {battery['current_mean']:.1f} A in the mean, {battery['current_max']:.1f} A at most"
        sentences.append(Sentence(f"{text}.", "Battery:"))
    if any("±" in sentence.text for sentence in sentences):
        sentences.append(
            Sentence("± is the half width of the 90 % interval of a mean of this flight.")
        )
    return sentences


def health_sentences(vehicle: dict[str, Any]) -> list[Sentence]:
    """Returns what became of the motors in flight, where that was looked for, and what the autopilot warned of."""
    sentences = list[Sentence]()
    told = vehicle["autopilot_alarms"]
    if "watched" in vehicle:
        # is above all else already
        is_said = Override.MOTORS in [override["kind"] for override in vehicle["overrides"]]
        changes = [
            one["sentence"]
            for kind in ("alarms", "recoveries", "torque_changes")
            for one in vehicle[kind]
        ]
        none = f"no motor was found to lose thrust in {vehicle['condition']['settled']:.0f} s of settled flight."
        text = " ".join(changes) or (none if vehicle["watched"] else UNWATCHED)
        sentences = [] if is_said else [Sentence(text, "Health:")]
    if told:
        shown = [
            f"“{one['text']}” ({one['severity']}, {one['time']:.0f} s)"
            for one in told[:MOST_ALARMS]
        ]
        more = (
            [f"{len(told) - MOST_ALARMS} others (--json has them)"]
            if len(told) > MOST_ALARMS
            else []
        )
        sentences.append(Sentence(f"{listed([*shown, *more])}.", "The autopilot warned:"))
    return sentences


def _interval(value: float, half: float | None, scale: float = 100.0, unit: str = " %") -> str:
    shown = rounded(scale * value) if half is None else plus_minus(scale * value, scale * half)
    return f"{shown}{unit}"


def log_blocks(held: dict[str, Any]) -> list[Block]:
    """Returns all that a log ``held``, by ``mavdem.condition.inventory``: each vehicle, then what came from whom."""
    return [
        *(block for one in held["vehicles"] for block in vehicle_contents(one)),
        *stream_contents(held),
    ]


def vehicle_contents(vehicle: dict[str, Any]) -> list[Block]:
    """Returns what a log holds of a ``vehicle``: whether a model can be learned, repairs, settled flight, messages.

    Where the vehicle has findings, these are said before, with the reason why there is no model.
    """
    verdict = vehicle["verdict"]
    names = vehicle["names"]
    messages = vehicle["messages"]
    axis = verdict["axis"]
    said = verdict["reason"] in vehicle.get("headline", "")
    what = f"A {axis} model" if axis in TILT_AXES else f"The physical parameters of {axis}"
    can = "can" if verdict["learnable"] else "cannot"
    if vehicle.get("model") == "slow motion":
        what = f"A model of the slow {axis} motion"
        can = "can"
    whose = f"{sender(vehicle)} ({vehicle['vehicle']}, {vehicle['autopilot']})"
    why = "." if said else f": {verdict['reason']}"
    blocks: list[Block] = [Sentence(f"{what} {can} be learned from {whose}{why}")]
    if verdict["remedy"] and "next_step" not in vehicle:
        blocks.append(Sentence(verdict["remedy"], "What to do:"))
    blocks += [*tier_sentences(vehicle), identity_sentence(vehicle["identity"])]
    blocks += [*condition_sentences(vehicle["condition"]), *health_sentences(vehicle)]
    blocks += map(caution, verdict["cautions"])
    blocks += [Sentence(repair, "Noted:") for repair in vehicle["repairs"]]
    if vehicle["segments"]:
        longest, *shorter = vehicle["segments"]
        others = (
            f", and {len(shorter)} shorter segment{'s' * (len(shorter) > 1)}" if shorter else ""
        )
        boot = (
            "boot" if vehicle["boots"] == 1 else f"boot {longest['boot'] + 1} of {vehicle['boots']}"
        )
        text = f"{longest['duration']:.1f} s, from {longest['start']:.1f} s after {boot}{others}."
        blocks.append(Sentence(text, "Settled flight:"))
    # names of the periodic messages by their rounded rate, the fastest first
    streams: dict[str, list[str]] = {}
    for name, one in sorted(messages.items(), key=lambda stream: -(stream[1]["rate"] or 0.0)):
        shown = f"{name} ({names[name]})" if name in names else name
        if one["rate"] and shown != "PARAM_VALUE":
            streams.setdefault(
                f"{one['rate']:.1f} Hz" if one["rate"] >= SLOW_HZ else "below 1 Hz", []
            ).append(shown)
    if streams and (format_name := vehicle["translated_from"]):
        blocks.append(
            Sentence(
                f"The motion, translated from {format_name} to the equivalent MAVLink messages:"
            )
        )
    if streams:
        text = "Messages and their mean rates over the whole log (the verdict's rates are those of the settled flight):"
        rows = [[rate, ", ".join(group)] for rate, group in streams.items()]
        blocks += [Sentence(text), Table(["rate", "messages"], rows, words=True)]
    return blocks


def stream_contents(held: dict[str, Any]) -> list[Sentence]:
    """Returns what was received from each sender, by the inventory ``held``, and what could not be decoded."""
    vehicles = [sender(one) for one in held["vehicles"]]
    blocks = []
    for speaker in held["speakers"]:
        name = sender(speaker)
        kind = (
            "no heartbeat"
            if speaker["kind"] == UNNAMED and name not in vehicles
            else speaker["kind"]
        )
        line = f"From {name} ({kind}): {speaker['messages']} messages"
        # A ground station numbers its messages to all links together, so its gaps have no meaning.
        if name in vehicles and speaker["lost_share"] >= MIN_LOST_SHARE:
            line += f"; {100 * speaker['lost_share']:.0f} % of its sequence numbers are missing, {_why(speaker)}"
        blocks.append(Sentence(f"{line}."))
    unread: dict[tuple[str, str], list[str]] = {}
    for one in held["unread"]:
        unread.setdefault((sender(one), one["cause"]), []).append(str(one["message_id"]))
    sentences = (
        f"Not decoded from {of}: message id {', '.join(ids)} ({why})."
        for (of, why), ids in unread.items()
    )
    return [*blocks, *map(Sentence, sentences)]


def sender(component: dict[str, Any]) -> str:
    """Returns system and number of a ``component``, as in "1:1"."""
    return f"{component['system']}:{component['component']}"


def _why(speaker: dict[str, Any]) -> str:
    if speaker["missing_share"] is None:
        return "because the link lost messages or the log keeps only some"
    if speaker["missing_share"] < min(MIN_LOST_SHARE, speaker["lost_share"] / 2):
        return "but its streams have no gaps: the log keeps only some message types"
    return f"and about {100 * speaker['missing_share']:.0f} % of its streams' messages are missing: the link lost some"


def wind_words(wind: WindVelocity) -> tuple[str, str, str]:
    """Returns the speed with its interval, where it comes from, and its gusts; empty where that is not known."""
    (low, high) = wind.speed_interval
    known = wind.status["speed"] != Status.NOT_IDENTIFIABLE
    speed = (
        f"{wind.speed:.1f} m/s ({low:.1f} to {high:.1f})"
        if known
        else f"{low:.1f} to {high:.1f} m/s"
    )
    origin = (
        f" from {from_point(wind.direction)}, ± {wind.direction_interval:.0f}°"
        if wind.directed
        else ""
    )
    gusts = (
        f"; gusts up to {wind.gust:.1f} m/s over {wind.gust_seconds:.2g} s"
        if known and not wind.calm
        else ""
    )
    return f"below {high:.1f} m/s" if wind.calm else speed, origin, gusts


def wind_blocks(air: Air) -> list[Block]:
    """Returns speed and direction with intervals, what is not reported, and how far the autopilot's own is off."""
    wind, own, reason = air
    if wind is None:
        return [Sentence(reason, "Wind:")]
    text = f"{''.join(wind_words(wind))}. Intervals hold the mean with 90 %."
    known = wind.status["speed"] != Status.NOT_IDENTIFIABLE
    first, last = wind.time[[0, -1]]
    if (
        own is not None
        and (rows := (own.boot == wind.boot) & (own.time >= first) & (own.time <= last)).any()
    ):
        mean = own.values[rows].mean(axis=0)
        size = float(np.hypot(*mean))
        angle = coming_from(*mean)
        apart = [f"{size - wind.speed:+.1f} m/s"] if known else []
        apart += [f"{(angle - wind.direction + 180) % 360 - 180:+.0f}°"] if wind.directed else []
        off = (
            ": ".join([f" from {from_point(angle)}", *filter(None, [", ".join(apart)])])
            if size > 0.05
            else ""
        )
        text += f" The autopilot's own estimate is {size:.1f} m/s{off}."
    return [
        Sentence(text, "Wind:"),
        *(Sentence(why, f"{what.capitalize()}:") for what, why in wind.reasons.items()),
    ]
