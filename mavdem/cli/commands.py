"""The command ``mavdem``: its group of commands, shell completion, and the exit code of each error."""

import os
import sys
import traceback
from collections.abc import Sequence
from difflib import get_close_matches
from importlib import import_module
from typing import Any

import click
from click.shell_completion import shell_complete

from mavdem.cli.exit_codes import (
    EXIT_DONE,
    EXIT_ERROR,
    EXIT_INTERRUPTED,
    EXIT_PIPE_CLOSED,
    EXIT_UNSUPPORTED,
)
from mavdem.cli.help_text import NarrowHelpContext
from mavdem.cli.links import LINK_PATTERN
from mavdem.cli.output import report_error
from mavdem.cli.streams import prepare_streams, print_to_stderr, stderr_is_terminal
from mavdem.cli.termination import default_interrupt_action
from mavdem.errors import NotLearnable, Unreadable, error_message
from mavdem.extras import MissingExtra
from mavdem.facts import Fact
from mavdem.facts.command import RunEnd

COMMAND_GROUPS = {
    "After a flight": {
        "review": "Reports all that a log says: what happened, lights, next step.",
        "learn": "Learns a linear model, and reports what it is good for.",
        "tune": "Reports margins of the rate and attitude loops, and gains.",
        "wind": "Reports wind speed and direction, and the vehicle's drag.",
        "diff": "Reports what changed between A and B, and what did not.",
        "track": "Keeps a table of many flights, with the health of each vehicle.",
        "serve": "Shows dropped logs in a browser, and the library of flights.",
        "info": "Reports what a log holds and if a model can be learned.",
    },
    "In flight": {
        "live": "Attaches to a link and learns while the vehicle flies.",
    },
    "Simulate": {
        "fly": "Simulates the flight of a multirotor in wind.",
        "twin": "Makes a simulated vehicle of a log, and flies the log again.",
    },
    "Take along": {
        "convert": "Converts a log to another file format.",
        "open": "Learns from a log, and shows the dashboard at once.",
        "mcp": "Offers logs to an assistant (Model Context Protocol).",
    },
    "Methods compared": {
        "compare": "Compares forecasts with those of other methods, window by window.",
        "order": "Finds the model order (number of states) by the free energy.",
        "reproduce": "Runs the paper's experiments again and checks its claims.",
    },
}
"""What each command does, by its name, grouped by what one wants: the first line of the command's own help.

They are repeated here because ``mavdem --help`` lists them without importing the commands.
"""

COMMAND_SUMMARIES = {
    name: summary for group in COMMAND_GROUPS.values() for name, summary in group.items()
}
"""What each command does, by its name."""

MARKS_OF_SOURCES = (".", ":", "/", "\\")
"""Characters of paths and of addresses, which the name of a command does not have."""

ANNOUNCED_COMMANDS = ("learn", "tune", "wind")
"""Commands that say on a terminal which log they read, before their imports, which take a second; ``live`` says which
link it opens."""

COMPLETION_VARIABLE = "_MAVDEM_COMPLETE"
"""Environment variable by which Click's shell scripts ask for completions."""

TRACEBACK_VARIABLE = "MAVDEM_TRACEBACK"
"""Environment variable by which a user asks for the traceback of a defect."""


class LazyCommandGroup(click.Group):
    """A group that imports a command only when it is named.

    The imports of a command take a second, for which ``mavdem --help`` need not wait.
    """

    context_class = NarrowHelpContext

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Writes the list of commands into the help, each group under its heading, with one width for all names."""
        name_width = max(len(name) for name in COMMAND_SUMMARIES)
        for heading, summaries in COMMAND_GROUPS.items():
            rows = [(name.ljust(name_width), summary) for name, summary in summaries.items()]
            with formatter.section(heading):
                formatter.write_dl(rows)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Finds and imports the command that the arguments name.

        A log in the place of the command's name means ``mavdem review LOG``, which also reports a link or a log that
        does not exist. The activity is announced before the command is imported, since both import and reading may take
        a while.

        Args:
            ctx: Context of the group.
            args: Arguments after ``mavdem``, at least one.

        Returns:
            The name of the command, the command, and its arguments; the first two may be None while a shell requests
            completions.
        """
        first_argument = args[0]
        if first_argument not in self.commands and looks_like_source(first_argument):
            if first_argument.startswith("-"):
                # The name of the log stood behind "--", which the group has taken. Without it, it would be an option.
                args = ["--", *args]
            args = ["review", *args]
        name, command, command_args = super().resolve_command(ctx, args)
        if command is None:
            return name, command, command_args
        if command.name == "review":
            _announce_activity("Reviewing", command_args)
        elif command.name in ANNOUNCED_COMMANDS and stderr_is_terminal():
            _announce_activity("Reading", command_args)
        elif command.name == "live" and stderr_is_terminal():
            _announce_link(command_args)
        with default_interrupt_action():
            command = load_command(str(command.name))
        return name, command, command_args


def load_command(name: str) -> click.Command:
    """Imports a command: ``<name>_command`` of the module ``mavdem.cli.<name>``.

    Args:
        name: One of ``COMMAND_SUMMARIES``.

    Returns:
        The command, whose options refuse other options as their values, and whose help fits the terminal.
    """
    command: click.Command = getattr(import_module(f"mavdem.cli.{name}"), f"{name}_command")
    command.context_class = NarrowHelpContext
    for parameter in command.params:
        if parameter.callback is None:
            parameter.callback = _refuse_option_as_value
    return command


def _refuse_option_as_value(context: click.Context, parameter: click.Parameter, value: Any) -> Any:
    """Refuses the name of another option as the value of an option; Click's callback for all options without another.

    In ``--out --json`` the user has forgotten the value of ``--out``, and Click would write to a folder "--json".

    Args:
        context: Click's context of the command that is parsed.
        parameter: The option.
        value: Its value, of the type that the option has.

    Returns:
        The value.

    Raises:
        click.BadParameter: The value begins with two hyphens.
    """
    if str(value).startswith("--"):
        raise click.BadParameter(
            f"{value} is an option, and no value was given.", context, parameter
        )
    return value


def looks_like_source(argument: str) -> bool:
    """Returns whether an argument is the name of a file or folder, or the address of a link, and no mistyped command.

    No command has a dot, a colon or a slash. So a log that does not exist is reported as that, even if its ending is
    mistyped, and not as a command that does not exist.

    Args:
        argument: The argument, as the user gave it.
    """
    return os.path.exists(argument) or any(mark in argument for mark in MARKS_OF_SOURCES)


def _announce_activity(activity: str, args: Sequence[str]) -> None:
    """Reports on standard error which log a command is going to work on.

    Args:
        activity: Activity of the command, such as "Reading".
        args: Arguments of the command. An argument after one that begins with a hyphen is the value of an option, and
            not the log.
    """
    previous = ""
    for argument in args:
        # A log that does not exist will not be read.
        if os.path.exists(argument) and not previous.startswith("-"):
            print_to_stderr(f"{activity} {argument} …")
        previous = argument


def _announce_link(args: Sequence[str]) -> None:
    """Reports on standard error which link ``mavdem live`` is going to open, once its imports are done.

    Args:
        args: Arguments of the command, of which the first that looks like a MAVLink link is announced.
    """
    for argument in args:
        if LINK_PATTERN.match(argument):
            print_to_stderr(f"Opening {argument} …")
            return


@click.group(
    cls=LazyCommandGroup,
    commands=[click.Command(name, help=summary) for name, summary in COMMAND_SUMMARIES.items()],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="mavdem")
def mavdem() -> None:
    """What happened in this flight, may I fly again, what do I change?

    mavdem answers from the flight log of a multirotor, or from its MAVLink stream. Each figure has its 90 % interval,
    or the reason why it is not known.

    \b
    1. What happened, and may I fly again? Read the screen, then
       flight/report.html in a browser.
         mavdem flight.tlog
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

    With --json every command but serve and mcp prints one JSON document on standard output. Exit codes: 0 done; 1 the
    data cannot support the request; 2 bad usage or unreadable input. A command ended by Ctrl-C (130), SIGTERM (143) or
    a closed pipe (141) may print no document.
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Errors are reported on standard error. ``SystemExit`` is the only exception that leaves this function.

    Args:
        arguments: Arguments after ``mavdem``; the arguments of the process unless given.

    Returns:
        Exit code of the process.
    """
    args = sys.argv[1:] if arguments is None else list(arguments)
    prepare_streams()
    try:
        if COMPLETION_VARIABLE in os.environ:
            instruction = os.environ[COMPLETION_VARIABLE]
            return shell_complete(mavdem, {}, "mavdem", COMPLETION_VARIABLE, instruction)
        code = _exit_code(args, as_json="--json" in args)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        code = EXIT_PIPE_CLOSED
    except OSError as error:
        report_error(
            Fact(RunEnd.STANDARD_OUTPUT_FAILED, reason=error_message(error)), as_json=False
        )
        code = EXIT_ERROR
    # Python flushes standard output again at its exit. It is replaced by the null device, so that this cannot fail.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


def _exit_code(args: list[str], *, as_json: bool) -> int:
    """Runs one command, reports its error if there is one, and returns the exit code.

    No error reaches the user as a traceback: each becomes a fact with a sentence and a remedy. An error of mavdem
    itself is reported as a defect; with the environment variable ``TRACEBACK_VARIABLE`` its traceback is printed too.

    Args:
        args: Arguments after ``mavdem``.
        as_json: Whether an error is also printed as a JSON document.

    Returns:
        ``EXIT_DONE``; the code that the command chose itself; ``EXIT_UNSUPPORTED`` for a log that is sound but shows
        too little; ``EXIT_INTERRUPTED`` after Ctrl-C; otherwise ``EXIT_ERROR``.

    Raises:
        OSError: Standard output cannot be written to.
    """
    try:
        _run_command(args)
    except click.exceptions.Exit as end:
        return end.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        error.show(sys.stderr)
    except click.ClickException as error:
        command_path = "mavdem"
        if isinstance(error, click.UsageError) and error.ctx:
            command_path = error.ctx.command_path
        report_error(
            Fact(RunEnd.BAD_USAGE, text=_usage_message(error), name=command_path), as_json=as_json
        )
    except NotLearnable as error:
        report_error(error.fact, as_json=as_json)
        return EXIT_UNSUPPORTED
    except (Unreadable, MissingExtra) as error:
        report_error(error.fact, as_json=as_json)
    except KeyboardInterrupt:
        report_error(Fact(RunEnd.INTERRUPTED), as_json=as_json)
        return EXIT_INTERRUPTED
    except MemoryError:
        report_error(Fact(RunEnd.OUT_OF_MEMORY), as_json=as_json)
    except Exception as error:
        # Commands report failures of files by name, so an error without one is that of standard output.
        if isinstance(error, OSError) and error.filename is None:
            raise
        if os.environ.get(TRACEBACK_VARIABLE):
            traceback.print_exc()
        report_error(
            Fact(RunEnd.DEFECT, reason=f"{type(error).__name__}: {error}"), as_json=as_json
        )
    else:
        return EXIT_DONE
    return EXIT_ERROR


def _usage_message(error: click.ClickException) -> str:
    """Returns what is wrong with the arguments; for an unknown option with options that are spelled similarly.

    Click compares names with their dashes, which all options share. It would suggest "--version" for "--wrong", so that
    its suggestions are compared again without the dashes.

    Args:
        error: the error that Click raised.
    """
    if not isinstance(error, click.NoSuchOption) or not error.possibilities:
        return error.format_message()
    letters = error.option_name.lstrip("-")
    similar_options = [
        option for option in error.possibilities if get_close_matches(letters, [option.lstrip("-")])
    ]
    return click.NoSuchOption(error.option_name, possibilities=similar_options).format_message()


def _run_command(args: list[str]) -> None:
    """Parses the arguments after ``mavdem`` and runs the command that they name.

    Args:
        args: The arguments, the name of the command first.

    Raises:
        click.ClickException: The arguments are wrong.
        Exception: Whatever the command raises.
    """
    # A folder with an empty name would be the current one, whose results would be replaced.
    if "" in args or "--out=" in args:
        raise click.UsageError("An argument is empty: name a file or folder, or leave it out.")
    if args and args[0] == "--json":
        # All commands but one have this option, which may stand before their name too.
        args = [*args[1:], "--json"]
    with mavdem.make_context(mavdem.name, list(args)) as context:
        mavdem.invoke(context)
