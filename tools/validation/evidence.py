#!/usr/bin/env python
"""Writes the tables of docs/evidence anew, each by the command that stands above it.

A table stands in a block of cog (https://cog.readthedocs.io). The first line of the block is a comment that names the
command; below stand the command, the commit at which it was run, and what it printed. The last line has a checksum, so
that a figure changed by hand is noticed. Two more blocks follow from the pages: how many claims are reproduced, and the
list of the pages in index.md, each with the first paragraph of its page.

Usage: tools/evidence [--list | --summaries] [TEXT]. With a text, only the commands that contain it are run; with
--summaries none. All of them take hours.
"""

import os
import re
import shlex
import subprocess
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import click
from cogapp import Cog

ROOT = Path(__file__).parents[2]
"""The folder of the repository, in which the commands are run."""

INDEX = ROOT / "docs" / "evidence" / "index.md"
"""The page that lists the others."""

PAGES = [*sorted(set(INDEX.parent.glob("*.md")) - {INDEX}), INDEX]
"""The pages that hold the tables; the index comes last, since it follows from the others."""

PROGRAM_FOLDERS = ("mavdem", "sitl_scenarios", "tools")
"""Folders of the repository that a printed figure depends on."""

_BLOCK = re.compile(
    r'<!-- \[\[\[cog printed\("(?P<command>[^"]+)"\) \]\]\] -->\n'
    r"`[^`]+`, at `(?P<commit>[^`]+)`:\n\n"
    r"(?P<output>.*?)\n?"
    r"<!-- \[\[\[end\]\]\]",
    re.DOTALL,
)

_WHOLE_BLOCK = re.compile(r"<!-- \[\[\[cog .*?<!-- \[\[\[end[^\n]*\n?", re.DOTALL)
"""A block with its marks."""

_BLOCK_MARK = re.compile(r"<!-- \[\[\[(cog|end).*\n?")
"""First or last line of a block."""

_CLAIM = re.compile(
    r"^\*\*[^*\n]+:\*\* (Reproduced|Partly|Not reproduced|Not tried):", re.MULTILINE
)
"""Beginning of the findings on a claim, as `mavdem reproduce --markdown` prints them."""

_TITLE = re.compile("# (?:Evidence: )?(.*)")
"""First line of a page."""


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


def written_by_hand(text: str) -> str:
    """Returns the text of a page without its blocks."""
    return _WHOLE_BLOCK.sub("", text)


def summary(page: Path) -> str:
    """Returns the summary of a page: the paragraph below its title."""
    text = _BLOCK_MARK.sub("", page.read_text(encoding="utf-8"))
    return " ".join(text.split("\n\n")[1].split())


def claim_counts(text: str) -> str:
    """Returns a sentence that counts the paper's reproduced claims, such as "Of 2 claims: 1 reproduced, 1 partly.".

    Args:
        text: the page on the paper, with the findings on each claim as `mavdem reproduce --markdown` prints them.
    """
    statuses = _CLAIM.findall(text)
    counts = []
    for status in ("Reproduced", "Partly", "Not reproduced", "Not tried"):
        if status in statuses:
            counts.append(f"{statuses.count(status)} {status.lower()}")
    return f"Of {len(statuses)} claims: {', '.join(counts)}."


def page_list() -> str:
    """Returns the lines of the index in Markdown: a link to each page, and its summary."""
    lines = []
    for page in PAGES:
        if page == INDEX:
            continue
        title = _TITLE.findall(page.read_text(encoding="utf-8"))[0]
        lines.append(f"- [{title[0].upper()}{title[1:]}]({page.name}): {summary(page)}")
    return "\n".join(lines)


def output_of(command: str) -> str:
    """Runs a command in the folder of the repository.

    Args:
        command: the command, as typed in a shell; nothing but its words is interpreted.

    Returns:
        What it printed to standard output, without white space at its ends.

    Raises:
        subprocess.CalledProcessError: if it fails.
    """
    # Recorded flights lie beside the repository unless the environment names another folder.
    environment = {"MAVDEM_SHARED_DATA": str(ROOT.parent / "shared" / "data"), **os.environ}
    run = subprocess.run(
        shlex.split(command),
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return run.stdout.strip()


def without_padding(text: str) -> str:
    """Returns Markdown whose tables have no spaces beside their bars.

    The number of words of the documentation is limited, and a bar between spaces would count as a word.

    Args:
        text: Markdown, in which every line that begins with a bar is one of a table.
    """
    lines = []
    for line in text.split("\n"):
        if line.startswith("|"):
            line = "|".join(cell.strip() for cell in line.split("|"))
        lines.append(line)
    return "\n".join(lines)


def current_commit() -> str:
    """Returns the abbreviated commit of the repository, followed by "with changes" if the program differs from it."""
    commit = output_of("git rev-parse --short HEAD")
    changes = output_of(f"git status --porcelain -- {' '.join(PROGRAM_FOLDERS)}")
    return f"{commit} with changes" if changes else commit


def write_tables(command_part: str) -> int:
    """Runs commands anew and writes their output into the pages, and then what is computed from the pages themselves.

    Args:
        command_part: text by which commands are chosen: only those that contain it are run, all if it is empty.

    Returns:
        The exit code of cog: 0 unless a command failed or a table was changed by hand.
    """
    new_table = partial(_new_table, command_part, current_commit())
    return run_cog(new_table, ["-r"]) or write_summaries()


def _new_table(command_part: str, commit: str, command: str, previous: str) -> str:
    """Returns the text that a page shows of a command, in Markdown: the command, the commit, and its output as a table.

    Args:
        command_part: text by which commands are chosen: one that does not contain it is not run.
        commit: abbreviated commit of the repository, at which the command is run.
        command: the command, which is run in a shell's syntax.
        previous: the text that the page shows so far. It stays if the command is not run.
    """
    if command_part not in command:
        return previous
    # The user sees on standard error which command runs, since some take long.
    click.echo(command, err=True)
    return f"`{command}`, at `{commit}`:\n\n{without_padding(output_of(command))}\n"


def write_summaries() -> int:
    """Computes the counts of claims and the list of pages anew, and returns the exit code of cog."""
    return run_cog(_previous_table, ["-r"])


def is_inconsistent() -> bool:
    """Returns whether a table was changed by hand, or the counts of claims or the list do not follow from the pages."""
    return run_cog(_previous_table, ["--check"]) != 0


def _previous_table(_command: str, previous: str) -> str:
    """Returns the text of a block as it stands in the page: its command is not run."""
    return previous


def run_cog(table_text: Callable[[str, str], str], options: list[str]) -> int:
    """Runs cog, a tool that replaces the text below each of its comments in a page by the output of the code in it.

    The code in the comments of our pages is one call: ``printed("a command")``, ``claims()`` or ``pages()``. These
    three functions are defined here. They print by the tool's own module ``cog``, which also knows the page and the
    text that stands below the comment so far.

    Args:
        table_text: function that returns the text of a table, given its command and its text in the page.
        options: options of cog: "-r" to write the pages, "--check" to compare them only.

    Returns:
        The exit code of cog.
    """
    cog = Cog()
    cog_module: Any = cog.cogmodule

    def printed(command: str) -> None:
        """Prints the text of a table; pages call it with the command of the table."""
        cog_module.out(table_text(command, cog_module.previous))

    def claims() -> None:
        """Prints how many claims of the page are reproduced; the page of a paper calls it."""
        page = Path(cog_module.inFile)
        cog_module.outl(claim_counts(page.read_text(encoding="utf-8")))

    def pages() -> None:
        """Prints the list of the pages; the index calls it."""
        cog_module.outl(page_list())

    cog.options.defines.update(printed=printed, claims=claims, pages=pages)
    # With -c each block gets a checksum of its output, by which a later change by hand is noticed.
    page_paths = [str(page) for page in PAGES]
    return cog.main(["cog", *options, "-c", "--verbosity=1", *page_paths])


@click.command(help=__doc__)
@click.argument("command_part", metavar="[TEXT]", default="")
@click.option("--list", "only_list", is_flag=True, help="Print the commands; run nothing.")
@click.option("--summaries", is_flag=True, help="Write what follows from the pages; run nothing.")
def main(command_part: str, only_list: bool, summaries: bool) -> None:
    """Writes the tables of docs/evidence anew, or prints the list of the commands that make them.

    Args:
        command_part: text that a command must contain to be run; all commands are run if it is empty.
        only_list: whether to print the commands and to run none.
        summaries: whether to run no command, and to write only what is computed from the pages themselves: how many
            claims of a paper are reproduced, and the list of pages.
    """
    if only_list:
        for table in measured_tables():
            click.echo(f"{table.page.name}, at {table.commit}: {table.command}")
        return
    exit_code_of_cog = write_summaries() if summaries else write_tables(command_part)
    if exit_code_of_cog != 0:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
