"""``mavdem``: the group of commands, their completion by a shell, and what becomes of errors."""

import os
import signal
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module
from itertools import pairwise
from typing import Any

import click
from click.shell_completion import shell_complete

from mavdem.cli.output import (
    DONE,
    INTERRUPTED,
    OF_SIGNAL,
    UNSUPPORTED,
    UNUSABLE,
    complain,
    ending_at_once,
    prepare_streams,
    say_aside,
)
from mavdem.errors import NotLearnable, Unreadable, error_message
from mavdem.extras import MissingExtra
from mavdem.facts import Fact
from mavdem.facts.command import End
from mavdem.log_formats import COMPRESSED_ENDING, UNCOMPRESSED_ENDINGS

PIPE_CLOSED = OF_SIGNAL + signal.SIGPIPE  # the exit code, as a shell reports SIGPIPE
HELP = {
    "review": "Reports all that a log says: what happened, lights, next step.",
    "info": "Reports what a log holds and if a model can be learned.",
    "learn": "Learns a linear model, and reports what it is good for.",
    "open": "Learns from a log, and shows the dashboard at once.",
    "wind": "Reports wind speed and direction, and the vehicle's drag.",
    "tune": "Reports margins of the rate and attitude loops, and gains.",
    "compare": "Compares DEM with other methods, window by window.",
    "order": "Finds the model order (number of states) by the free energy.",
    "diff": "Reports what changed between A and B, and what did not.",
    "track": "Keeps a table of many flights, with the health of each vehicle.",
    "serve": "Shows dropped logs in a browser, and the library of flights.",
    "live": "Attaches to a link and learns while the vehicle flies.",
    "convert": "Converts a log to another file format.",
    "twin": "Makes a simulated vehicle of a log, and flies the log again.",
    "fly": "Simulates the flight of a quadrotor in wind.",
    "reproduce": "Runs the paper's experiments again and checks its claims.",
}
"""What each command does, by name: the first line of its own help."""
# Environment variable by which click's shell scripts ask for completions
COMPLETION = "_MAVDEM_COMPLETE"


def imported_command(name: str) -> click.Command:
    """Returns the command of this name, from the module that is named like it."""
    command = getattr(import_module(f"mavdem.cli.{name}"), f"{name}_command")
    for parameter in command.params:
        parameter.callback = parameter.callback or _no_option
    return command


def _no_option(context: click.Context, parameter: click.Parameter, value: Any) -> Any:
    """Refuses an option as the value of another, which was then forgotten: ``--out --json``."""
    if str(value).startswith("--"):
        raise click.BadParameter(
            f"{value} is an option, and no value was given.", context, parameter
        )
    return value


def is_log(word: str) -> bool:
    """Returns whether a first ``word`` is a log's name, there or not, or that of any file or folder: no command."""
    return os.path.exists(word) or word.lower().removesuffix(COMPRESSED_ENDING).endswith(
        UNCOMPRESSED_ENDINGS
    )


class _Commands(click.Group):
    """Imports a command when it is named: what it needs takes a second, which ``--help`` need not wait."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in self.commands and is_log(args[0]):
            args = ["review", *args]
        name, command, rest = super().resolve_command(ctx, args)
        if command is not None:
            if command.name == "review":
                for before, word in pairwise(["", *rest]):
                    if is_log(word) and not before.startswith("-"):
                        say_aside(f"Reviewing {word} …")
            with ending_at_once():
                command = imported_command(str(command.name))
        return name, command, rest


@click.group(
    cls=_Commands,
    commands=[click.Command(name, help=text) for name, text in HELP.items()],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="mavdem")
def mavdem() -> None:
    """What happened in this flight, may I fly again, what do I change?

    mavdem answers from the flight log of a multirotor, or from its MAVLink stream. Each figure has its 90 % interval,
    or the reason why it is not known.

    \b
    1. What happened, and may I fly again? Read the screen, then the page.
         mavdem flight.tlog
         xdg-open flight/report.html
    2. Do the control loops have enough margin, and which gains suit them?
         mavdem tune flight.tlog --out tuned
    3. What does the log hold, and what does a model still need?
         mavdem info flight.tlog
    4. Which of many flights or vehicles is different?
         mavdem track logs/ --out fleet
    5. Who else should see the flights? Drop logs in a browser, share pages.
         mavdem serve
    6. What does the vehicle do while it flies?
         mavdem live udpin:127.0.0.1:14550

    \b
    No log at hand? Simulate a flight in wind:
      mavdem fly hover_blower --out flight.tlog

    Any log shows what happened. Models and margins need attitude, and motor outputs or the controller's demand, at
    40 Hz or more, better 100 Hz.

    With --json every command prints one JSON document on standard output. Exit codes: 0 done; 1 the data cannot support
    the request; 2 bad usage or unreadable input. A command ended by Ctrl-C (130), SIGTERM (143) or a closed pipe (141)
    may print no document.
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command with these words, or those of the process, and returns its exit code; raises SystemExit only."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    prepare_streams()
    try:
        if COMPLETION in os.environ:
            return shell_complete(mavdem, {}, "mavdem", COMPLETION, os.environ[COMPLETION])
        code = _run(words, as_json="--json" in words)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        code = PIPE_CLOSED  # the reader has had enough
    except OSError as error:
        complain(Fact(End.STANDARD_OUTPUT_FAILED, because=error_message(error)), as_json=False)
        code = UNUSABLE
    # Python flushes once more at exit, and that must go somewhere.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


def _run(words: list[str], as_json: bool) -> int:
    try:
        # a folder without a name would be the current one, whose results are replaced
        if {"", "--out="}.intersection(words):
            raise click.UsageError("An argument is empty: name a file or folder, or leave it out.")
        with mavdem.make_context(mavdem.name, list(words)) as context:
            mavdem.invoke(context)
    except click.exceptions.Exit as end:
        return end.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        error.show(sys.stderr)
    except click.ClickException as error:
        where = (
            error.ctx.command_path
            if isinstance(error, click.UsageError) and error.ctx
            else "mavdem"
        )
        complain(Fact(End.BAD_USAGE, text=error.format_message(), name=where), as_json)
    except NotLearnable as error:
        complain(error.fact, as_json)
        return UNSUPPORTED
    except (Unreadable, MissingExtra) as error:
        complain(error.fact, as_json)
    except KeyboardInterrupt:
        complain(Fact(End.INTERRUPTED), as_json)
        return INTERRUPTED
    except MemoryError:
        complain(Fact(End.OUT_OF_MEMORY), as_json)
    except Exception as error:
        if isinstance(error, OSError) and error.filename is None:
            raise  # standard output: the only thing written to here that has no name
        if os.environ.get("MAVDEM_TRACEBACK"):
            traceback.print_exc()
        complain(Fact(End.DEFECT, because=f"{type(error).__name__}: {error}"), as_json)
    else:
        return DONE
    return UNUSABLE
