"""``mavdem info``: what a log holds, and whether a model can be learnt from it."""

from __future__ import annotations

from typing import Any

import click

from mavdem.cli.output import complain, print_json, say
from mavdem.cli.source import read_source, source_options
from mavdem.inventory import inventory

WIDTH = 100
"""Columns to which the list of messages is wrapped."""

SLOW = 0.95
"""Hz below which messages are listed together: what comes less than about once a second tells nothing of the motion."""

WORTH_TELLING = 0.01
"""Share of a vehicle's sequence numbers that do not occur; fewer is a radio link in good order."""


@click.command()
@source_options
@click.pass_context
def info(
    context: click.Context, source: str, axis: str, vehicle: str | None, inputs: str | None, as_json: bool
) -> None:
    """Says what a log holds, and whether a model can be learnt from it.

    SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz. For each vehicle: the verdict
    (learnable or not, why, and what to change), the stretches of settled flight, and its messages with their rates.
    --json tells everything, for example the counts; why not is then also said on standard error.

    Ends with 0 when a model can be learnt from at least one vehicle, otherwise with 1.
    """
    held = inventory(read_source(source), axis, vehicle, inputs)
    if as_json:
        print_json(held)
    else:
        for one in held["vehicles"]:
            _print_vehicle(one)
        if not held["vehicles"]:
            say("There is no vehicle in it: check that the autopilot's own messages are recorded.\n")
        _print_stream(held)
    if not held["learnable"]:
        if as_json:
            # The document is printed already, with all the reasons.
            complain(f"No {axis} model can be learnt from {source}{_first_reason(held)}", "", as_json=False)
        context.exit(1)


def _first_reason(held: dict[str, Any]) -> str:
    if not held["vehicles"]:
        return ": there is no vehicle in it."
    one = held["vehicles"][0]
    return f"; {_name(one)}: {one['verdict']['reason']}"


def _print_vehicle(one: dict[str, Any]) -> None:
    verdict = one["verdict"]
    can = "can" if verdict["learnable"] else "cannot"
    say(
        f"A {verdict['axis']} model {can} be learnt from {_name(one)} ({one['vehicle']}, {one['autopilot']}): "
        f"{verdict['reason']}"
    )
    if verdict["remedy"]:
        say(f"What to do: {verdict['remedy']}")
    for caution in verdict["cautions"]:
        say(f"Caution: {caution}")
    for repair in one["repairs"]:
        say(f"Repaired: {repair}")
    if one["segments"]:
        longest, *shorter = one["segments"]
        others = f", and {len(shorter)} shorter" if shorter else ""
        say(
            f"Settled flight: {longest['duration']:.1f} s, from {longest['start']:.1f} s after "
            f"{_boot(longest['boot'] + 1, one['boots'])}{others}."
        )
    streams = _by_rate(one["messages"])
    if streams and one["translated_from"]:
        say(f"Of the motion, brought from {one['translated_from']} to the MAVLink messages that say the same:")
    if streams:
        say("Messages, at their mean rates over the whole log (the verdict's are those of its stretch of flight):")
    for rate, names in streams.items():
        say(click.wrap_text(f"{rate}: {', '.join(names)}", WIDTH, "  ", "    "))
    say()


def _boot(number: int, boots: int) -> str:
    return "boot" if boots == 1 else f"boot {number} of {boots}"


def _by_rate(messages: dict[str, dict[str, Any]]) -> dict[str, list[str]]:
    """Names of the messages that are sent again and again, by their rounded rate, the fastest first."""
    streams = {name: message["rate"] for name, message in messages.items() if message["rate"] and name != "PARAM_VALUE"}
    groups: dict[str, list[str]] = {}
    for name, rate in sorted(streams.items(), key=lambda stream: -stream[1]):
        told = f"{rate:.1f} Hz" if rate >= SLOW else "less than once a second"
        groups.setdefault(told, []).append(name)
    return groups


def _print_stream(held: dict[str, Any]) -> None:
    vehicles = [_name(one) for one in held["vehicles"]]
    for speaker in held["speakers"]:
        heard = f"Heard {_name(speaker)} {speaker['kind']}: {speaker['messages']} messages"
        # A ground station numbers what it sends to all its links together, so its gaps say nothing.
        if _name(speaker) in vehicles and speaker["lost_share"] >= WORTH_TELLING:
            heard += f"; {speaker['lost_share']:.0%} of its sequence numbers do not occur, {_why(speaker)}"
        say(f"{heard}.")
    for sender, cause in dict.fromkeys((_name(unread), unread["cause"]) for unread in held["unread"]):
        ids = [str(u["message_id"]) for u in held["unread"] if (_name(u), u["cause"]) == (sender, cause)]
        say(f"Not read from {sender}: message id {', '.join(ids)} ({cause}).")


def _why(speaker: dict[str, Any]) -> str:
    if speaker["missing_share"] is None:
        return "as when a link loses messages or a log keeps only some"
    if speaker["missing_share"] < min(WORTH_TELLING, speaker["lost_share"] / 2):
        return "but its streams have no gaps: the log keeps only some kinds of messages"
    return f"and about {speaker['missing_share']:.0%} of its streams' messages are missing: the link lost some"


def _name(sender: dict[str, Any]) -> str:
    return f"{sender['system']}:{sender['component']}"
