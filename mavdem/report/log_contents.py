"""The report of what a log holds: verdict, repairs, settled flight, messages with their rates, and senders."""

from __future__ import annotations

from typing import Any

from mavdem.alignment.drive import TILT_AXES
from mavdem.ingest.vocabulary import UNNAMED
from mavdem.report.blocks import Sentence, Table
from mavdem.report.condition import condition_sentences, identity_sentence, tier_sentences

SLOW_HZ = 0.95  # messages below this rate are listed together: they are too slow to describe the motion
MIN_LOST_SHARE = 0.01  # share of missing sequence numbers from which it is reported; less is a radio link in good order


def log_blocks(held: dict[str, Any]) -> list[Sentence | Table]:
    """All of an inventory of ``mavdem.condition.inventory``: each vehicle, then what was received from whom."""
    vehicles = [block for one in held["vehicles"] for block in vehicle_contents(one)]
    return [*vehicles, *stream_contents(held)]


def vehicle_contents(one: dict[str, Any]) -> list[Sentence | Table]:
    """Of one vehicle: whether a model can be learnt, cautions, repairs, settled flight, and a table of its messages."""
    verdict = one["verdict"]
    can = "can" if verdict["learnable"] else "cannot"
    axis = verdict["axis"]
    what = f"A {axis} model" if axis in TILT_AXES else f"The physical parameters of {axis}"
    blocks: list[Sentence | Table] = [
        Sentence(
            f"{what} {can} be learnt from {sender(one)} ({one['vehicle']}, {one['autopilot']}): {verdict['reason']}"
        )
    ]
    if verdict["remedy"]:
        blocks.append(Sentence(verdict["remedy"], "What to do:"))
    blocks += [*tier_sentences(one), identity_sentence(one["identity"]), *condition_sentences(one["condition"])]
    blocks += [Sentence(caution, "Caution:") for caution in verdict["cautions"]]
    blocks += [Sentence(repair, "Noted:") for repair in one["repairs"]]
    if one["segments"]:
        longest, *shorter = one["segments"]
        others = f", and {len(shorter)} shorter segment{'s' * (len(shorter) > 1)}" if shorter else ""
        boot = _boot(longest["boot"] + 1, one["boots"])
        text = f"{longest['duration']:.1f} s, from {longest['start']:.1f} s after {boot}{others}."
        blocks.append(Sentence(text, "Settled flight:"))
    named = {name: f"{name} ({one['names'][name]})" if name in one["names"] else name for name in one["messages"]}
    streams = _by_rate({named[name]: message for name, message in one["messages"].items()})
    if streams and one["translated_from"]:
        blocks.append(
            Sentence(f"The motion, translated from {one['translated_from']} to the equivalent MAVLink messages:")
        )
    if streams:
        blocks += [
            Sentence(
                "Messages and their mean rates over the whole log (the verdict's rates are those of the settled "
                "flight):"
            ),
            Table(["rate", "messages"], [[rate, ", ".join(names)] for rate, names in streams.items()], words=True),
        ]
    return blocks


def stream_contents(held: dict[str, Any]) -> list[Sentence]:
    """What was received from each sender, and what could not be decoded."""
    vehicles = [sender(one) for one in held["vehicles"]]
    blocks = []
    for speaker in held["speakers"]:
        name = sender(speaker)
        kind = "no heartbeat" if speaker["kind"] == UNNAMED and name not in vehicles else speaker["kind"]
        line = f"From {name} ({kind}): {speaker['messages']} messages"
        # A ground station numbers its messages to all links together, so its gaps have no meaning.
        if name in vehicles and speaker["lost_share"] >= MIN_LOST_SHARE:
            line += f"; {speaker['lost_share']:.0%} of its sequence numbers are missing, {_why(speaker)}"
        blocks.append(Sentence(f"{line}."))
    for source, cause in dict.fromkeys((sender(unread), unread["cause"]) for unread in held["unread"]):
        ids = [str(u["message_id"]) for u in held["unread"] if (sender(u), u["cause"]) == (source, cause)]
        blocks.append(Sentence(f"Not decoded from {source}: message id {', '.join(ids)} ({cause})."))
    return blocks


def sender(one: dict[str, Any]) -> str:
    """System and component, as in "1:1"."""
    return f"{one['system']}:{one['component']}"


def _boot(number: int, boots: int) -> str:
    return "boot" if boots == 1 else f"boot {number} of {boots}"


def _by_rate(messages: dict[str, dict[str, Any]]) -> dict[str, list[str]]:
    """Names of the periodic messages by their rounded rate, the fastest first."""
    streams = {name: message["rate"] for name, message in messages.items() if message["rate"] and name != "PARAM_VALUE"}
    groups: dict[str, list[str]] = {}
    for name, rate in sorted(streams.items(), key=lambda stream: -stream[1]):
        label = f"{rate:.1f} Hz" if rate >= SLOW_HZ else "below 1 Hz"
        groups.setdefault(label, []).append(name)
    return groups


def _why(speaker: dict[str, Any]) -> str:
    if speaker["missing_share"] is None:
        return "because the link lost messages or the log keeps only some"
    if speaker["missing_share"] < min(MIN_LOST_SHARE, speaker["lost_share"] / 2):
        return "but its streams have no gaps: the log keeps only some message types"
    return f"and about {speaker['missing_share']:.0%} of its streams' messages are missing: the link lost some"
