"""``mavdem``: the group of commands, and what becomes of errors."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence

import click

from mavdem.cli.info import info
from mavdem.cli.learn import learn
from mavdem.cli.output import complain, prepare_streams
from mavdem.errors import NotLearnable, Unreadable

DONE, UNSUPPORTED, UNUSABLE, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 130, 141
"""Exit codes: done; the data cannot support the request; bad usage or unreadable input; and as a shell reports SIGINT
and SIGPIPE."""


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="mavdem")
def mavdem() -> None:
    """Learns what a multirotor does in wind from its flight logs.

    From motor outputs and attitude in a MAVLink telemetry log, Dynamic Expectation Maximization learns a linear model
    of the roll or pitch motion with the precision of every parameter, forecasts with it, and says how good the
    forecasts are beside trivial ones.

    \b
    Is a log good enough, and if not, what to change:
      mavdem info flight.tlog

    \b
    Learn from it, and look at the result:
      mavdem learn flight.tlog --out result
      rerun result/flight.rrd

    Every command ends with 0 when done, 1 when the data cannot support the request, and 2 on bad usage or input that
    cannot be read.
    """


mavdem.add_command(info)
mavdem.add_command(learn)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command and answers its exit code; no exception but SystemExit leaves it.

    Args:
        arguments: the words after ``mavdem``; those of the process unless given.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    prepare_streams()
    try:
        code = _run(words, as_json="--json" in words)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader has had enough. Python flushes once more at exit, and that must go somewhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_CLOSED
    return code


def _run(words: list[str], as_json: bool) -> int:
    try:
        with mavdem.make_context("mavdem", list(words)) as context:
            mavdem.invoke(context)
    except click.exceptions.Exit as end:
        return end.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
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
    except BrokenPipeError:
        raise
    except Exception as error:
        if os.environ.get("MAVDEM_TRACEBACK"):
            traceback.print_exc()
        what = f"{type(error).__name__}: {error}".replace("\n", " ")
        complain(
            f"This should not have happened ({what}).", "Run it again with MAVDEM_TRACEBACK=1 to see where.", as_json
        )
        return UNUSABLE
    return DONE
