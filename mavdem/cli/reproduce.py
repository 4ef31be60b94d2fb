"""``mavdem reproduce``: the paper's experiments, run again, and a report on its claims."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import click
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from mavdem.cli.output import STDERR, json_text, print_json, print_table, say
from mavdem.cli.output_files import check_folder, writing
from mavdem.cli.signals import ending_at_once
from mavdem.dem.parallel import pool, spare_cores
from mavdem.errors import require
from mavdem.paper.claims import CLAIMS

if TYPE_CHECKING:
    from mavdem.paper.report import ItemReport
    from mavdem.paper.runner import Runner


@click.command("reproduce")
@click.argument("names", metavar="[ITEM]...", nargs=-1, type=click.Choice([claim.name for claim in CLAIMS]))
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("build/paper"),
    show_default=True,
    help="Folder for the report.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the numbers as one JSON document and nothing else.")
@click.option("--list", "as_list", is_flag=True, help="List the items, one a line, the name first.")
def reproduce_command(names: tuple[str, ...], out: Path, as_json: bool, as_list: bool) -> None:
    """Runs the paper's experiments again and checks its claims.

    ITEM is a name from --list; all items run unless some are named, which takes some minutes on two cores. The report
    is a folder with the page index.html and its figures, numbers.json, and experiment.rrd for Rerun. It needs the extra
    `paper`: pip install "mavdem[paper]".

    \b
    Examples:
      mavdem reproduce --list
      mavdem reproduce noise prediction --out build/paper
    """
    if as_list:
        for claim in CLAIMS:
            say(f"{claim.name:14}  {claim.title} ({claim.section})")
        return
    with ending_at_once():
        require("`mavdem reproduce`", "paper")
        from mavdem.paper.report import ITEMS, NUMBERS, PAGE, RECORDING, ItemReport, document
        from mavdem.paper.runner import Extent, Runner

    check_folder(out, (PAGE, NUMBERS, RECORDING))
    began = perf_counter()
    chosen = {item.claim.title: item for item in ITEMS if item.claim.name in names or not names}
    with _ItemProgress() as bar, pool(spare_cores()) as executor:
        runner = Runner(Extent(), executor, bar.jobs)
        reports = [ItemReport(chosen[title], chosen[title].run(runner)) for title in bar.each(chosen)]
        bar.begin("Writing the report")
        write_report(out, reports, runner, perf_counter() - began)
    if as_json:
        print_json(document(reports, perf_counter() - began))
        return
    _print(reports)
    say(f"Took {perf_counter() - began:.0f} s. Written: {out / PAGE}")


def write_report(out: Path, reports: Sequence[ItemReport], runner: Runner, seconds: float) -> None:
    """Writes the report, numbers.json included, into a folder that need not exist, or raises ``Unreadable``."""
    from mavdem.paper.report import NUMBERS, document, write

    with writing(out):
        write(out, reports, runner, seconds)
        (out / NUMBERS).write_text(json_text(document(reports, seconds)) + "\n")


class _ItemProgress(Progress):
    """A line for each item on standard error, with the number of its finished jobs."""

    def __init__(self) -> None:
        columns = (TextColumn("{task.description:48}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        super().__init__(*columns, console=STDERR)
        self._item: TaskID

    def each(self, titles: Iterable[str]) -> Iterator[str]:
        """Each title, with a line that begins when it does."""
        for title in titles:
            self.begin(title)
            yield title
            self.stop_task(self._item)

    def begin(self, title: str) -> None:
        """Begins the line of the current item."""
        self._item = self.add_task(title, total=0)

    def jobs(self, count: int) -> Callable[[], None]:
        """Adds jobs to the current item; returns the function to call when one of them is done."""
        (task,) = [one for one in self.tasks if one.id == self._item]
        self.update(task.id, total=(task.total or 0) + count)
        return partial(self.advance, task.id)


def _print(reports: Iterable[ItemReport]) -> None:
    table = Table("item", "verdict", "findings")
    for one in reports:
        table.add_row(one.item.claim.name, one.status.value, f"{one.sentence} {one.beyond}".rstrip())
    print_table(table)
