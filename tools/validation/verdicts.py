#!/usr/bin/env python
"""The verdict on every log of a folder: exit code of `mavdem info`, settled flight, and the reason; a line a vehicle.

Lines are the same from run to run, so that two versions are compared with diff.

Usage: tools/validation/verdicts.py FOLDER [--axis pitch]
"""

from __future__ import annotations

import json
from pathlib import Path

import click
from click.testing import CliRunner

from mavdem.cli.commands import mavdem
from mavdem.errors import Unreadable

OTHER_FILES = {".json", ".md", ".npz", ".txt"}  # Notes and arrays that lie beside logs


@click.command(help=__doc__)
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--axis", default="roll", type=click.Choice(["roll", "pitch"]))
def main(folder: Path, axis: str) -> None:
    for path in sorted(folder.rglob("*")):
        if not path.is_file() or path.suffix in OTHER_FILES:
            continue
        done = CliRunner().invoke(mavdem, ["info", str(path), "--axis", axis, "--json"])
        name = path.relative_to(folder)
        if isinstance(done.exception, Unreadable):
            print(f"{name} | 2 | {str(done.exception).removeprefix(f'{path} ')}")
            continue
        vehicles = json.loads(done.stdout)["vehicles"]
        if not vehicles:
            print(f"{name} | {done.exit_code} | no vehicle")
        for one in vehicles:
            verdict, segments = one["verdict"], one["segments"]
            settled = f"{segments[0]['duration']:.1f} s" if segments else "-"
            who = f"{one['system']}:{one['component']} {one['vehicle']}"
            notes = " ".join([verdict["reason"], verdict["remedy"], *verdict["cautions"], *one["repairs"]])
            print(f"{name} | {done.exit_code} | {who} | {settled} | {notes}")


if __name__ == "__main__":
    main()
