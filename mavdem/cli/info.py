"""``mavdem info``: what a log holds, and whether a model can be learnt from it."""

from __future__ import annotations

from typing import Any

import click

from mavdem.alignment.drive import TILT_AXES
from mavdem.alignment.inventory import inventory
from mavdem.cli.options import source_options
from mavdem.cli.output import complain, print_json, say
from mavdem.cli.sources import read_source
from mavdem.ingest.vocabulary import UNNAMED

WRAP_COLUMNS = 100  # columns to which the list of messages is wrapped
SLOW_HZ = 0.95  # messages below this rate are listed together: they are too slow to describe the motion
MIN_LOST_SHARE = 0.01  # share of missing sequence numbers from which it is reported; less is a radio link in good order


@click.command("info")
@source_options
@click.pass_context
def info_command(
    context: click.Context, source: str, axis: str, vehicle: str | None, inputs: str | None, as_json: bool
) -> None:
    """Reports what a log holds and if a model can be learnt.

    SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz. For each vehicle it prints the
    verdict (can a model be learnt; if not, why and what to change), the settled flight, and the messages with their
    rates.
    --json has all details, for example message counts; the reason is then also printed on standard error.

    Exit code: 0 if a model can be learnt from at least one vehicle, otherwise 1.
    """
    held = inventory(read_source(source), axis, vehicle, inputs)
    if as_json:
        print_json(held)
    else:
        for one in held["vehicles"]:
            _print_vehicle(one)
        if not held["vehicles"]:
            say("There is no vehicle in this log: check that the autopilot's own messages are recorded.\n")
        _print_stream(held)
    if not held["learnable"]:
        if as_json:
            # The document is printed already, with all the reasons.
            complain(f"No {axis} model can be learnt from {source}{_first_reason(held)}", "", as_json=False)
        context.exit(1)


def _first_reason(held: dict[str, Any]) -> str:
    if not held["vehicles"]:
        return ": there is no vehicle in this log."
    one = held["vehicles"][0]
    return f"; {_name(one)}: {one['verdict']['reason']}"


def _print_vehicle(one: dict[str, Any]) -> None:
    verdict = one["verdict"]
    can = "can" if verdict["learnable"] else "cannot"
    axis = verdict["axis"]
    what = f"A {axis} model" if axis in TILT_AXES else f"The physical parameters of {axis}"
    say(f"{what} {can} be learnt from {_name(one)} ({one['vehicle']}, {one['autopilot']}): {verdict['reason']}")
    if verdict["remedy"]:
        say(f"What to do: {verdict['remedy']}")
    for caution in verdict["cautions"]:
        say(f"Caution: {caution}")
    for repair in one["repairs"]:
        say(f"Noted: {repair}")
    if one["segments"]:
        longest, *shorter = one["segments"]
        others = f", and {len(shorter)} shorter segment{'s' * (len(shorter) > 1)}" if shorter else ""
        say(
            f"Settled flight: {longest['duration']:.1f} s, from {longest['start']:.1f} s after "
            f"{_boot(longest['boot'] + 1, one['boots'])}{others}."
        )
    named = {name: f"{name} ({one['names'][name]})" if name in one["names"] else name for name in one["messages"]}
    streams = _by_rate({named[name]: message for name, message in one["messages"].items()})
    if streams and one["translated_from"]:
        say(f"The motion, translated from {one['translated_from']} to the equivalent MAVLink messages:")
    if streams:
        say("Messages and their mean rates over the whole log (the verdict's rates are those of the settled flight):")
    for rate, names in streams.items():
        say(click.wrap_text(f"{rate}: {', '.join(names)}", WRAP_COLUMNS, "  ", "    "))
    say()


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


def _print_stream(held: dict[str, Any]) -> None:
    vehicles = [_name(one) for one in held["vehicles"]]
    for speaker in held["speakers"]:
        kind = "no heartbeat" if speaker["kind"] == UNNAMED and _name(speaker) not in vehicles else speaker["kind"]
        line = f"From {_name(speaker)} ({kind}): {speaker['messages']} messages"
        # A ground station numbers its messages to all links together, so its gaps have no meaning.
        if _name(speaker) in vehicles and speaker["lost_share"] >= MIN_LOST_SHARE:
            line += f"; {speaker['lost_share']:.0%} of its sequence numbers are missing, {_why(speaker)}"
        say(f"{line}.")
    for sender, cause in dict.fromkeys((_name(unread), unread["cause"]) for unread in held["unread"]):
        ids = [str(u["message_id"]) for u in held["unread"] if (_name(u), u["cause"]) == (sender, cause)]
        say(f"Not decoded from {sender}: message id {', '.join(ids)} ({cause}).")


def _why(speaker: dict[str, Any]) -> str:
    if speaker["missing_share"] is None:
        return "because the link lost messages or the log keeps only some"
    if speaker["missing_share"] < min(MIN_LOST_SHARE, speaker["lost_share"] / 2):
        return "but its streams have no gaps: the log keeps only some message types"
    return f"and about {speaker['missing_share']:.0%} of its streams' messages are missing: the link lost some"


def _name(sender: dict[str, Any]) -> str:
    return f"{sender['system']}:{sender['component']}"
