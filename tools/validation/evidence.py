#!/usr/bin/env python
"""Writes the tables of docs/evidence anew, each by the command that stands above it.

A table stands in a block of cog (https://cog.readthedocs.io). The first line of the block is a comment that names the
command; below stand the command, the commit at which it was run, and what it printed. The last line has a checksum, so
that a figure changed by hand is noticed.

Usage: tools/evidence [--list] [TEXT]. With a text, only the commands that contain it are run. All of them take hours.
"""

import re
import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import click
from cogapp import Cog

ROOT = Path(__file__).parents[2]
"""The folder of the repository, in which the commands are run."""

PAGES = sorted((ROOT / "docs" / "evidence").glob("*.md"))
"""The pages that hold the tables."""

PROGRAM_FOLDERS = ("mavdem", "sitl_scenarios", "tools")
"""Folders of the repository that a printed figure depends on."""

_BLOCK = re.compile(
    r'<!-- \[\[\[cog printed\("(?P<command>[^"]+)"\) \]\]\] -->\n'
    r"`[^`]+`, at `(?P<commit>[^`]+)`:\n\n"
    r"(?P<output>.*?)\n?"
    r"<!-- \[\[\[end\]\]\]",
    re.DOTALL,
)


class MeasuredTable(NamedTuple):
    """A block of a page: what a command printed, and when."""

    page: Path
    """The page that holds it."""
    command: str
    """The command, as typed in the folder of the repository."""
    commit: str
    """The abbreviated commit at which the command was run."""
    output: str
    """What the command printed to standard output, in Markdown."""


def measured_tables() -> list[MeasuredTable]:
    """Returns the blocks of all pages of docs/evidence, in the order of the pages."""
    tables = []
    for page in PAGES:
        for block in _BLOCK.finditer(page.read_text(encoding="utf-8")):
            tables.append(MeasuredTable(page, **block.groupdict()))
    return tables


def output_of(command: str) -> str:
    """Runs a command in the folder of the repository.

    Args:
        command: the command, as typed in a shell; nothing but its words is interpreted.

    Returns:
        What it printed to standard output, without white space at its ends.

    Raises:
        subprocess.CalledProcessError: if it fails.
    """
    run = subprocess.run(
        shlex.split(command), cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True
    )
    return run.stdout.strip()


def current_commit() -> str:
    """Returns the abbreviated commit of the repository, followed by "with changes" if the program differs from it."""
    commit = output_of("git rev-parse --short HEAD")
    changes = output_of(f"git status --porcelain -- {' '.join(PROGRAM_FOLDERS)}")
    return f"{commit} with changes" if changes else commit


def write_tables(text: str) -> int:
    """Runs the commands that contain a text and writes what they print into the pages.

    Args:
        text: part of the commands to run.

    Returns:
        The exit code of cog: 0 unless a command failed or a table was changed by hand.
    """
    commit = current_commit()

    def print_block(command: str, previous: str) -> str:
        """Returns the new content of a block; the previous one if its command is not to be run."""
        if text not in command:
            return previous
        click.echo(command, err=True)
        return f"`{command}`, at `{commit}`:\n\n{output_of(command)}\n"

    return run_cog(print_block, ["-r"])


def changed_by_hand() -> bool:
    """Returns whether a checksum of a table differs from that of its text."""
    return run_cog(lambda _command, previous: previous, ["--check"]) != 0


def run_cog(print_block: Callable[[str, str], str], options: list[str]) -> int:
    """Runs cog over the pages.

    Args:
        print_block: function of the command of a block and its previous content that returns its new content.
        options: options of cog that say what happens to the pages.

    Returns:
        The exit code of cog.
    """
    cog = Cog()
    generator: Any = cog.cogmodule

    def printed(command: str) -> None:
        """Prints the content of a block; the pages call it."""
        generator.out(print_block(command, generator.previous))

    cog.options.defines["printed"] = printed
    return cog.main(["cog", *options, "-c", "--verbosity=1", *map(str, PAGES)])


@click.command(help=__doc__)
@click.argument("text", default="")
@click.option("--list", "only_list", is_flag=True, help="Print the commands; run nothing.")
def main(text: str, only_list: bool) -> None:
    if only_list:
        for table in measured_tables():
            click.echo(f"{table.page.name}, at {table.commit}: {table.command}")
        return
    if write_tables(text) != 0:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
