#!/usr/bin/env python
"""Damages log files at random, and checks that the reader and commands read or refuse each without error and in time.

Usage: tools/fuzz/damage.py LOG... [--count N] [--seed N] [--command read|info|review|convert]

Every log is damaged N times, each time in a way drawn by the seed: cut off, without its head, with flipped bits, holes,
zeros, swapped, repeated or foreign blocks, with numbers that are huge, infinite or NaN, or under another ending. The
outcome must be a log or one sentence within ``--limit`` seconds of processor time more than the sound log takes. What
damage there is must not make a reboot, or a record that lasts longer. Failing inputs stay in the folder ``--keep``.
"""

import contextlib
import io
import random
import struct
import time
import traceback
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from fuzz_checksums import with_checksums

from mavdem.cli.commands import main as mavdem_main
from mavdem.errors import Unreadable
from mavdem.ingest import read_log
from mavdem.ingest.telemetry import Log

Damage = Callable[[bytes, random.Random, bytes], bytes]
"""Makes a damaged log of the sound one, a source of chance, and another log."""

FLIPPED_BITS = 200
"""Largest number of bits that are flipped."""

BLOCK_BYTES = 1 << 14
"""Largest size of the blocks that are removed, moved or overwritten, bytes."""

HUGE_NUMBERS = (
    struct.pack("<I", 0xFFFFFFF0),
    struct.pack("<Q", 1 << 62),
    struct.pack("<f", float("nan")),
    struct.pack("<f", float("inf")),
    struct.pack("<d", float("-inf")),
    struct.pack("<f", 3e38),
)
"""What stands in the place of numbers: lengths of gigabytes, and values that are none."""

CHECKSUMS_SHARE = 0.5
"""Share of the damaged telemetry logs whose frames get correct checksums, so that their content is read."""

OTHER_ENDING_SHARE = 0.1
"""Share of the damaged logs that get another ending."""

MAX_ADDED_SECONDS = 1.0
"""Seconds by which a damaged log may last longer than the sound one."""

SHOWN_CHARACTERS = 1500
"""Characters of a failure that are shown: the last ones, where a traceback has its reason."""

OTHER_ENDINGS = (".tlog", ".bin", ".ulg", ".mcap", ".log", ".zip", ".json", "")
"""Endings under which a log may be given."""


def _block(content: bytes, chance: random.Random) -> slice:
    """Returns a block of a log, of random size and place."""
    size = chance.randint(1, min(BLOCK_BYTES, max(len(content) // 3, 1)))
    start = chance.randrange(max(len(content) - size, 1))
    return slice(start, start + size)


def cut_off(content: bytes, chance: random.Random, _: bytes) -> bytes:
    """Cuts off the end."""
    return content[: chance.randrange(len(content))]


def without_head(content: bytes, chance: random.Random, _: bytes) -> bytes:
    """Cuts off the beginning."""
    return content[chance.randrange(len(content)) :]


def flipped(content: bytes, chance: random.Random, _: bytes) -> bytes:
    """Flips single bits."""
    damaged_content = bytearray(content)
    for _number in range(chance.randint(1, FLIPPED_BITS)):
        damaged_content[chance.randrange(len(damaged_content))] ^= 1 << chance.randrange(8)
    return bytes(damaged_content)


def with_hole(content: bytes, chance: random.Random, _: bytes) -> bytes:
    """Removes a block."""
    block = _block(content, chance)
    return content[: block.start] + content[block.stop :]


def overwritten(content: bytes, chance: random.Random, _: bytes) -> bytes:
    """Overwrites a block with zeros, ones or noise."""
    block = _block(content, chance)
    size = block.stop - block.start
    filling = chance.choice([bytes(size), b"\xff" * size, chance.randbytes(size)])
    return content[: block.start] + filling + content[block.stop :]


def swapped(content: bytes, chance: random.Random, _: bytes) -> bytes:
    """Returns a log in which two successive blocks of random place and equal size are swapped.

    Args:
        content: bytes of the log.
        chance: source of random numbers.
        _: bytes of another log, which is not used.
    """
    size = chance.randint(1, min(BLOCK_BYTES, max(len(content) // 3, 1)))
    start = chance.randrange(max(len(content) - 2 * size, 1))
    middle = start + size
    end = middle + size
    return content[:start] + content[middle:end] + content[start:middle] + content[end:]


def repeated(content: bytes, chance: random.Random, _: bytes) -> bytes:
    """Writes a block twice."""
    block = _block(content, chance)
    return content[: block.stop] + content[block] + content[block.stop :]


def spliced(content: bytes, chance: random.Random, other_content: bytes) -> bytes:
    """Returns a log in which a block of another log is inserted at a random place.

    Args:
        content: bytes of the log.
        chance: source of random numbers.
        other_content: bytes of the other log.
    """
    block = _block(content, chance)
    return (
        content[: block.start]
        + other_content[_block(other_content, chance)]
        + content[block.start :]
    )


def with_huge_numbers(content: bytes, chance: random.Random, _: bytes) -> bytes:
    """Returns a log in which bytes at some random places encode a huge number, infinity or NaN.

    Args:
        content: bytes of the log.
        chance: source of random numbers.
        _: bytes of another log, which is not used.
    """
    damaged_content = bytearray(content)
    for _number in range(chance.randint(1, 40)):
        number = chance.choice(HUGE_NUMBERS)
        start = chance.randrange(max(len(damaged_content) - len(number), 1))
        damaged_content[start : start + len(number)] = number
    return bytes(damaged_content)


DAMAGES: tuple[Damage, ...] = (
    cut_off,
    without_head,
    flipped,
    with_hole,
    overwritten,
    swapped,
    repeated,
    spliced,
    with_huge_numbers,
)
"""All kinds of damage."""

DAMAGES_WITHOUT_NEW_TIMES = (cut_off, flipped, with_hole, overwritten, repeated)
"""Damages that bring in no time stamp of another time: the log must not seem longer after them."""


class LogExtent(NamedTuple):
    """Number of boots and duration of a log, which damage must not increase."""

    boots: int
    """Number of boots of all vehicles."""

    duration: float
    """Longest time from the first message to the last in a boot, s."""


def log_extent(log: Log) -> LogExtent:
    """Returns the number of boots of a log, and the longest time that messages of one name span in one boot.

    Args:
        log: the log; all its messages are decoded.

    Returns:
        The largest values of all messages of all vehicles.
    """
    most_boots = 0
    longest_duration = 0.0
    for vehicle in log.vehicles:
        for columns in vehicle.messages.values():
            boots = np.unique(columns["boot"])
            most_boots = max(most_boots, len(boots))
            for boot in boots.tolist():
                times = columns["time"][columns["boot"] == boot]
                longest_duration = max(longest_duration, float(np.ptp(times)))
    return LogExtent(most_boots, longest_duration)


class Attempt(NamedTuple):
    """Result of one run of the reader or of a command on a file."""

    seconds: float
    """Processor time, s."""

    failure: str
    """What went wrong; empty if nothing did."""

    extent: LogExtent | None
    """Boots and duration of the log; None if it was refused, or a command was run."""


def attempt(path: Path, command: str) -> Attempt:
    """Runs the reader or a command on a file, and records its time, its failure and the extent of the log.

    Refusing a damaged log in one line is no failure. Any other exception is one, and so is a message of an internal
    error, or output of the reader, which is to print nothing.

    Args:
        path: path of the file.
        command: "read" for the reader alone, otherwise a command of mavdem.
    """
    failure = ""
    extent = None
    start = time.process_time()
    output = io.StringIO()
    # Commands leave their results in the folder where they run.
    with (
        contextlib.redirect_stdout(output),
        contextlib.redirect_stderr(output),
        contextlib.chdir(path.parent),
    ):
        try:
            if command == "read":
                extent = log_extent(read_log(path))
            elif command == "convert":
                mavdem_main(["convert", str(path), str(path.with_name("converted.csv"))])
            elif command == "review":
                mavdem_main([str(path), "--json"])
            else:
                mavdem_main([command, str(path), "--json"])
        except Unreadable as error:
            if "\n" in str(error):
                failure = f"several lines: {error}"
        except Exception:
            failure = traceback.format_exc()
    printed = output.getvalue()
    # The command line catches internal errors, and says of them that they should not have happened.
    if "should not have happened" in printed or "Traceback" in printed:
        failure = printed
    elif command == "read" and printed:
        failure = f"prints: {printed}"
    return Attempt(time.process_time() - start, failure, extent)


def failure_by_damage(
    damaged: Attempt, sound: Attempt, limit: float, *, must_not_be_longer: bool
) -> str:
    """Describes what is wrong with the way in which a damaged log was read, compared with the sound log.

    An error, much more processor time, or a log that seems longer than the sound one is wrong.

    Args:
        damaged: the attempt with the damaged log.
        sound: the attempt with the sound log.
        limit: seconds of processor time that damage may add.
        must_not_be_longer: whether to compare boots and duration, since the damage brings in no stamps of other times.

    Returns:
        The failure as text; empty if nothing is wrong.
    """
    if damaged.failure:
        return damaged.failure
    if damaged.seconds > sound.seconds + limit:
        return f"takes {damaged.seconds:.1f} s, {sound.seconds:.1f} s when sound"
    if must_not_be_longer and damaged.extent and sound.extent:
        lasts_longer = damaged.extent.duration > sound.extent.duration + MAX_ADDED_SECONDS
        if lasts_longer or damaged.extent.boots > sound.extent.boots:
            return f"{damaged.extent}, sound {sound.extent}"
    return ""


class DamagedLog(NamedTuple):
    """A damaged copy of a log."""

    content: bytes
    """Bytes of the copy."""

    ending: str
    """Ending of its file name, by which the reader chooses a format; it may belong to another format."""

    damage_name: str
    """Name of the damage."""

    must_not_be_longer: bool
    """Whether the damage brings in no time stamps of another time, so that the log must not seem longer."""


def damaged_log(log: Path, contents: Mapping[Path, bytes], chance: random.Random) -> DamagedLog:
    """Damages a log in a random way, and may give it correct checksums or the ending of another format.

    Args:
        log: path of the sound log.
        contents: bytes of all sound logs; bytes of another one may get into the damaged one.
        chance: source of random numbers.
    """
    damage = chance.choice(DAMAGES)
    other_content = contents[chance.choice(list(contents))]
    content = damage(contents[log], chance, other_content)
    must_not_be_longer = damage in DAMAGES_WITHOUT_NEW_TIMES
    if log.suffix == ".tlog" and chance.random() < CHECKSUMS_SHARE:
        # Damaged time stamps are read only if the checksums are correct.
        content = with_checksums(bytearray(content))
        must_not_be_longer = False
    has_other_ending = chance.random() < OTHER_ENDING_SHARE
    ending = chance.choice(OTHER_ENDINGS) if has_other_ending else log.suffix
    return DamagedLog(content, ending, damage.__name__, must_not_be_longer)


@click.command(help=__doc__)
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@click.option("--count", default=30)
@click.option("--seed", default=1)
@click.option("--command", default="read")
@click.option("--limit", default=5.0)
@click.option("--keep", default="damaged", type=click.Path(path_type=Path))
def main(
    logs: tuple[Path, ...], count: int, seed: int, command: str, limit: float, keep: Path
) -> None:
    """Damages each log ``count`` times, runs the command on the copies, and prints each failure and their number.

    Args:
        logs: sound logs.
        count: number of damaged copies of each log.
        seed: seed of the random damage.
        command: "read" for the reader alone, otherwise a command of mavdem.
        limit: seconds of processor time that damage may cost.
        keep: folder for the copies; those that made something fail stay in it.
    """
    warnings.simplefilter("ignore")
    keep.mkdir(parents=True, exist_ok=True)
    keep = keep.resolve()
    logs = tuple(log.resolve() for log in logs)
    failures = 0
    contents = {log: log.read_bytes() for log in logs}
    for log, content in contents.items():
        sound_copy = keep / log.name
        sound_copy.write_bytes(content)
        sound_attempt = attempt(sound_copy, command)
        for number in range(count):
            chance = random.Random(f"{seed} {number} {log.name}")
            damaged = damaged_log(log, contents, chance)
            path = keep / f"{log.stem[:20]} {number}{damaged.ending}"
            path.write_bytes(damaged.content)
            failure = failure_by_damage(
                attempt(path, command),
                sound_attempt,
                limit,
                must_not_be_longer=damaged.must_not_be_longer,
            )
            if failure:
                failures += 1
                shown_failure = failure[-SHOWN_CHARACTERS:]
                print(f"--- {path}, {damaged.damage_name}\n{shown_failure}", flush=True)
            else:
                path.unlink()
    print(f"{failures} failures of {count * len(logs)}")


if __name__ == "__main__":
    main()
