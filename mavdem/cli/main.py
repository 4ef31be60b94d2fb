"""``mavdem``: the group of commands, and what becomes of errors."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module

import click

from mavdem.cli.output import complain, prepare_streams, say_aside
from mavdem.cli.signals import INTERRUPTED, ending_at_once
from mavdem.errors import NotLearnable, Unreadable

DONE, UNSUPPORTED, UNUSABLE, PIPE_CLOSED = 0, 1, 2, 141
"""Exit codes: done; the data cannot support the request; bad usage, unreadable input or output that fails; and as a
shell reports SIGPIPE."""


class _Commands(click.Group):
    """Imports a command when it is to run: what it needs takes a second, which ``--help`` need not wait."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name, command, rest = super().resolve_command(ctx, args)
        if command is not None:
            with ending_at_once():
                command = getattr(import_module(f"mavdem.cli.{command.name}"), str(command.name))
        return name, command, rest


@click.group(
    cls=_Commands,
    commands=[
        click.Command("info", help="Says what a log holds, and whether a model can be learnt from it."),
        click.Command("learn", help="Learns a linear model from a log and forecasts with it."),
        click.Command("compare", help="Compares DEM with other methods, window by window."),
        click.Command("order", help="Finds how many states the motion has, by the free energy."),
        click.Command("live", help="Attaches to a link and learns while the vehicle flies."),
        click.Command("convert", help="Converts a log to another file format."),
        click.Command("fly", help="Flies a simulated quadrotor in wind."),
    ],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="mavdem")
def mavdem() -> None:
    """Learns what a multirotor does in wind from its flight logs.

    From motor outputs and attitude in a log, Dynamic Expectation Maximization learns a linear model of the roll or
    pitch motion with the precision of every parameter, forecasts with it, and says how good the forecasts are beside
    trivial ones.

    \b
    Is a log good enough, and if not, what to change:
      mavdem info flight.tlog

    \b
    Learn from it, and look at the result:
      mavdem learn flight.tlog --out result
      rerun result/flight.rrd

    \b
    How does it do beside other methods?
      mavdem compare flight.tlog

    \b
    How many states has the motion?
      mavdem order flight.tlog

    \b
    No log at hand? Fly one:
      mavdem fly hover_blower --out flight.tlog

    Every command ends with 0 when done, 1 when the data cannot support the request, and 2 on bad usage or input that
    cannot be read; then --json prints a document too. Ended from outside, by Ctrl-C (130), SIGTERM (143) or a reader
    that has had enough (141), it may print none.
    """


def main(arguments: Sequence[str] | None = None, command: click.Command = mavdem) -> int:
    """Runs one command and answers its exit code; no exception but SystemExit leaves it.

    Args:
        arguments: the words after ``mavdem``; those of the process unless given.
        command: that takes them.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    prepare_streams()
    try:
        code = _run(command, words, as_json="--json" in words)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        code = PIPE_CLOSED  # the reader has had enough
    except OSError as error:
        complain(f"Standard output cannot be written to ({error.strerror or error}).", "", as_json=False)
        code = UNUSABLE
    # Python flushes once more at exit, and that must go somewhere.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


def _run(command: click.Command, words: list[str], as_json: bool) -> int:
    try:
        with command.make_context(command.name, list(words)) as context:
            command.invoke(context)
    except click.exceptions.Exit as end:
        return end.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        say_aside(error.format_message())
        return UNUSABLE
    except click.ClickException as error:
        where = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else "mavdem"
        complain(error.format_message(), f"Try `{where} --help`.", as_json)
        return UNUSABLE
    except NotLearnable as error:
        complain(error.reason, error.remedy, as_json)
        return UNSUPPORTED
    except Unreadable as error:
        complain(str(error), "", as_json)
        return UNUSABLE
    except KeyboardInterrupt:
        complain("Interrupted; nothing is left half written.", "", as_json)
        return INTERRUPTED
    except Exception as error:
        if isinstance(error, OSError) and error.filename is None:
            raise  # standard output: the only thing written to here that has no name
        if os.environ.get("MAVDEM_TRACEBACK"):
            traceback.print_exc()
        complain(
            f"This should not have happened ({type(error).__name__}: {error}).",
            "Run it again with MAVDEM_TRACEBACK=1 to see where.",
            as_json,
        )
        return UNUSABLE
    return DONE
