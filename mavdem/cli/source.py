"""SOURCE, and the options that choose what is looked at in it or in what a link brings: the same for every command."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable
from typing import Any, TypeVar

import click

from mavdem.cli.output import progress
from mavdem.errors import Unreadable
from mavdem.ingest import Log, read_log

Command = TypeVar("Command", bound=Callable[..., Any])

LINK = re.compile(r"(udp|tcp|mcast|ws)\w*:|/dev/(tty|cu|serial)|COM\d", re.IGNORECASE)
"""How pymavlink's connection strings begin (``mavutil.mavlink_connection``)."""

VEHICLE = re.compile(r"\d{1,3}(:\d{1,3})?", re.ASCII)
"""MAVLink's ids."""

Value = TypeVar("Value")


def no_option(context: click.Context, parameter: click.Parameter, value: Value) -> Value:
    """Refuses an option in the place of another's value, which was then forgotten: ``--out --json``."""
    if str(value).startswith("--"):
        raise click.BadParameter(f"{value} is an option, and no value was given.", context, parameter)
    return value


def _vehicle(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    no_option(context, parameter, value)
    if value is not None and not VEHICLE.fullmatch(value):
        raise click.BadParameter(
            f"{value!r} is no vehicle: give its MAVLink system id, or system and component as in 1:1.",
            context,
            parameter,
        )
    return value


def motion_options(command: Command) -> Command:
    """Adds --axis, --vehicle, --inputs and --json to a command: what is looked at, and how it is told."""
    for decorate in (
        click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else."),
        click.option(
            "--inputs",
            type=click.Choice(["motors", "demand"]),
            help="What drives the axis: the motors' outputs, or what the controller asked of it before the mixer. "
            "[default: motors, or the demand where only that comes fast enough]",
        ),
        click.option(
            "--vehicle",
            metavar="SYSTEM[:COMPONENT]",
            callback=_vehicle,
            help="Which vehicle, where there are several.",
        ),
        click.option("--axis", type=click.Choice(["roll", "pitch"]), default="roll", show_default=True),
    ):
        command = decorate(command)
    return command


def source_options(command: Command) -> Command:
    """Adds SOURCE and the same options to a command."""
    return click.argument("source", type=click.Path())(motion_options(command))


def refuse_link(source: str) -> None:
    """Refuses a link in the place of a log.

    Raises:
        Unreadable: SOURCE is a link.
    """
    if LINK.match(source) and not os.path.isfile(source):
        attach = shlex.join(["mavdem", "live", source])
        raise Unreadable(f"{source} is a MAVLink link, and only logs are read here: attach to it with `{attach}`.")


def read_source(source: str) -> Log:
    """The log that SOURCE names.

    Raises:
        Unreadable: it is a link, or ``mavdem.ingest.read_log`` says so.
    """
    refuse_link(source)
    with progress(f"Reading {source}") as done:
        return read_log(source, done)
