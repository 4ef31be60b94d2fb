"""``tools/reproduce_paper``: some items or all, into a report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from time import perf_counter

import click
from paper.item import Item
from paper.laboratory import Extent, Laboratory
from paper.report import FIGURES, ITEMS, NUMBERS, PAGE, RECORDING, Judged, document, write
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from mavdem.cli.main import main
from mavdem.cli.new_file import writing
from mavdem.cli.output import ASIDE, print_json, print_table, say
from mavdem.cli.results import check_folder
from mavdem.cli.signals import unwind_when_terminated
from mavdem.dem.workers import pool, spare_cores


def run() -> int:
    """Runs the command of the process and answers its exit code, with errors and signals told as ``mavdem``'s are."""
    unwind_when_terminated()
    return main(command=reproduce)


@click.command("tools/reproduce_paper")
@click.argument("names", metavar="[ITEM]...", nargs=-1, type=click.Choice([item.name for item in ITEMS]))
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("build/paper"),
    show_default=True,
    help="Folder for the report.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the numbers as one JSON document and nothing else.")
@click.option("--list", "as_list", is_flag=True, help="List the items, one a line, the name first.")
def reproduce(names: tuple[str, ...], out: Path, as_json: bool, as_list: bool) -> None:
    """Runs the paper's experiments again and judges whether they come out.

    ITEM is a name from --list; all of them unless named. The report is a folder with a page that any browser opens from
    disk, index.html, its figures, the numbers as JSON, and a recording for Rerun.
    """
    if as_list:
        for item in ITEMS:
            say(f"{item.name:14}  {item.title} ({item.published.section})")
        return
    check_folder(out, (PAGE, NUMBERS, RECORDING))
    check_folder(out / FIGURES, ())
    began = perf_counter()
    chosen = [item for item in ITEMS if item.name in names or not names]
    with _Bar() as bar, pool(spare_cores()) as executor:
        laboratory = Laboratory(Extent(), executor, bar.jobs)
        judged = [Judged(item, item.run(laboratory)) for item in bar.items(chosen)]
        bar.begin("Writing the report")
        with writing(out):
            write(out, judged, laboratory, perf_counter() - began)
    if as_json:
        print_json(document(judged, perf_counter() - began))
        return
    _print(judged)
    say(f"Took {perf_counter() - began:.0f} s. Written: {out / PAGE}")


class _Bar(Progress):
    """A line for each item on standard error, with how many of its jobs are done."""

    def __init__(self) -> None:
        columns = (TextColumn("{task.description:48}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        super().__init__(*columns, console=ASIDE)
        self._item: TaskID

    def items(self, chosen: Iterable[Item]) -> Iterator[Item]:
        """Each item, with a line that begins when it does."""
        for item in chosen:
            self.begin(item.title)
            yield item
            self.stop_task(self._item)

    def begin(self, title: str) -> None:
        """Begins the line of what is done now."""
        self._item = self.add_task(title, total=0)

    def jobs(self, count: int) -> Callable[[], None]:
        """More of them to do in the item that is at it; answers what is called as each is done."""
        (task,) = [one for one in self.tasks if one.id == self._item]
        self.update(task.id, total=(task.total or 0) + count)
        return partial(self.advance, task.id)


def _print(judged: Iterable[Judged]) -> None:
    table = Table("item", "verdict", "why")
    for one in judged:
        table.add_row(one.item.name, one.verdict.value, f"{one.sentence} {one.beyond}".rstrip())
    print_table(table)
