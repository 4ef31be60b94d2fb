#!/usr/bin/env python
"""Fuzzes the readers of log formats with Atheris (libFuzzer): searches for a file that a reader fails on.

Usage: tools/fuzz/fuzz.py bin|mcap|tlog|ulg [CORPUS] [OPTIONS]

Coverage-guided, by atheris (``pip install atheris``, Linux and macOS). OPTIONS are libFuzzer's: ``-max_total_time=480``
stops after eight minutes, ``-artifact_prefix=FOLDER/`` names the folder for failing inputs. Useful inputs gather in
the folder CORPUS. It begins with small logs: of tlog with pieces of the logs in ``logs``, of the others with what
``pytest --basetemp FOLDER tests/ingest`` leaves. An input that fails is run again by naming its file, and becomes a
test of ``tests/ingest``.

An input is a file of the format; of a telemetry log every frame gets a correct checksum first, or hardly any change
would pass it. Any bytes are read, or refused with ``Unreadable`` in one sentence, within the time and the memory that
libFuzzer allows (``-timeout``, ``-rss_limit_mb``). Nothing is printed. Every column has as many rows as its ``time``,
no time is infinite, and ``mavdem info`` can report on it.

atheris 3.0 keeps the result of every traced comparison of arrays, so memory grows by up to 0.3 MB a run. Several runs
with ``-max_total_time=100`` and one corpus do more than one long run.
"""

import contextlib
import io
import tempfile
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import atheris
import click
import numpy as np

with atheris.instrument_imports(include=["mavdem"]):
    from fuzz_checksums import with_checksums

    from mavdem.assessment.inventory import inventory
    from mavdem.errors import NotLearnable, Unreadable
    from mavdem.ingest import Log, read_log

LOGS = Path(__file__).parents[2] / "logs"
MEMORY = Path("/dev/shm")


PIECES_PER_LOG = 6
"""Pieces of each telemetry log in the first corpus."""

PIECE_BYTES = 600
"""Length of a piece: some ten frames."""


def pieces() -> Iterator[bytes]:
    """Yields pieces of each telemetry log of the repository, evenly spread, as a first corpus."""
    for path in sorted(LOGS.glob("*.tlog")):
        content = path.read_bytes()
        for start in range(0, len(content), len(content) // PIECES_PER_LOG):
            yield content[start : start + PIECE_BYTES]


def check(kind: str, content: bytes) -> None:
    """Reads a file, and asserts that its reader holds the contract: it gives a consistent log, or refuses in one line.

    Args:
        kind: ending of the file, such as "tlog", by which its format is known.
        content: bytes of the file; frames of a "tlog" get checksums that match.
    """
    if kind == "tlog":
        content = with_checksums(bytearray(content))
    folder = MEMORY if MEMORY.exists() else None
    with (
        tempfile.NamedTemporaryFile(suffix=f".{kind}", dir=folder) as file,
        io.StringIO() as printed,
    ):
        file.write(content)
        file.flush()
        with contextlib.redirect_stdout(printed):
            try:
                log = read_log(file.name)
            except Unreadable as error:
                assert "\n" not in str(error), error
                return
        assert not printed.getvalue(), printed.getvalue()
    check_consistency(log)
    with contextlib.suppress(NotLearnable, Unreadable):
        inventory(log)


def check_consistency(log: Log) -> None:
    """Asserts that all times of a log are finite or NaN, and that all columns of a message are equally long.

    Args:
        log: the log of a flight, with the messages of each vehicle.
    """
    for vehicle in log.vehicles:
        for name, columns in vehicle.messages.items():
            assert not np.isinf(columns["time"]).any(), name
            lengths = {len(values) for values in columns.values()}
            assert lengths == {columns["time"].size}, name


@click.command(help=__doc__, context_settings={"ignore_unknown_options": True})
@click.argument("kind", metavar="FORMAT", type=click.Choice(["bin", "mcap", "tlog", "ulg"]))
@click.argument("arguments", metavar="[CORPUS] [OPTIONS]", nargs=-1, type=click.UNPROCESSED)
def main(kind: str, arguments: tuple[str, ...]) -> None:
    """Runs the fuzzer on the reader of one format, until it finds a failure or is stopped.

    Args:
        kind: format of the logs.
        arguments: folder of the corpus (the inputs that the fuzzer has found so far), and options of libFuzzer; or one
            file whose failure is repeated. The corpus of telemetry logs begins with short logs that are written here.
    """
    warnings.simplefilter("ignore")
    # Options begin with a dash.
    paths = [Path(argument) for argument in arguments if not argument.startswith("-")]
    if kind == "tlog" and paths and not paths[0].is_file():
        corpus = paths[0]
        corpus.mkdir(parents=True, exist_ok=True)
        for number, content in enumerate(pieces()):
            (corpus / f"seed_{number}").write_bytes(content)
    atheris.Setup([__file__, *arguments], partial(check, kind))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
