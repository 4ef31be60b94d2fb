"""``mavdem info``: what a log holds, and whether a model can be learned from it."""

from __future__ import annotations

from collections.abc import Iterable

import click

from mavdem.cli.options import source_options
from mavdem.cli.output import complain, print_json, say
from mavdem.cli.sources import read_source
from mavdem.condition.inventory import inventory
from mavdem.report.blocks import Block, Sentence
from mavdem.report.condition import sender, stream_contents, vehicle_contents


@click.command("info")
@source_options()
@click.pass_context
def info_command(
    context: click.Context, source: str, axis: str, vehicle: str | None, inputs: str | None, as_json: bool
) -> None:
    """Reports what a log holds and if a model can be learnt.

    SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz. For each vehicle it prints the
    verdict (can a model be learnt; if not, why and what to change), the settled flight, and the messages with their
    rates.
    --json has all details, for example message counts; the reason is then also printed on standard error.

    Exit code: 0 if a model can be learned from at least one vehicle, otherwise 1.
    """
    held = inventory(read_source(source), axis, vehicle, inputs)
    if as_json:
        print_json(held)
    else:
        for one in held["vehicles"]:
            _print([*vehicle_contents(one), Sentence("")])
        if not held["vehicles"]:
            say("There is no vehicle in this log: check that the autopilot's own messages are recorded.\n")
        _print(stream_contents(held))
    if not held["learnable"]:
        if as_json:
            # The document is printed already, with all the reasons.
            because = [f"; {sender(one)}: {one['verdict']['reason']}" for one in held["vehicles"]]
            because.append(": there is no vehicle in this log.")
            complain(f"No {axis} model can be learned from {source}{because[0]}", "", as_json=False)
        context.exit(1)


def _print(blocks: Iterable[Block]) -> None:
    for block in blocks:
        if isinstance(block, Sentence):
            say(f"{block.lead} {block.text}".lstrip())
        else:
            for rate, names in block.rows:
                say(click.wrap_text(f"{rate}: {names}", 100, "  ", "    "))
