#!/usr/bin/env python
"""What `mavdem info` says of every log of a folder; prints a line a vehicle, the same from run to run.

A line has the exit code; settled flight and tier; share of the time that the worst motor is at its upper limit, and
headroom, %; a limit cycle; headline and next step, as far as that version has them; the reason, its remedy and notes.
So two versions are compared with diff.

Usage: tools/validation/verdicts.py FOLDER [--axis pitch]
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
from click.testing import CliRunner

from mavdem.cli.commands import mavdem
from mavdem.errors import Unreadable

OTHER_FILES = {".json", ".md", ".npz", ".txt", ".csv", ".mat", ".usdlog"}  # Notes and arrays that lie beside logs


def figures(vehicle: dict[str, Any]) -> list[str]:
    """Returns settled flight, tier, limit, headroom, limit cycle, headline, next step and reason of a vehicle."""
    verdict, condition = vehicle["verdict"], vehicle.get("condition") or {}
    hover, swings = condition.get("hover") or {}, condition.get("oscillation")
    limit, room = hover.get("at_upper_limit"), hover.get("headroom")
    return [
        f"{vehicle['segments'][0]['duration']:.1f} s" if vehicle["segments"] else "-",
        f"tier {vehicle.get('tier')}",
        f"at limit {100 * max(limit):.1f} %" if limit else "-",
        f"headroom {100 * min(room):.0f} to {100 * max(room):.0f} %" if room else "-",
        " ".join(f"{name} {value}" for name, value in swings.items()) if swings else "no limit cycle",
        f"headline: {vehicle.get('headline', '-')}",
        f"next: {vehicle.get('next_step', vehicle.get('next_tier'))}",
        " ".join([verdict["reason"], verdict["remedy"], *verdict["cautions"], *vehicle["repairs"]]),
    ]


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
        lines = [[f"{one['system']}:{one['component']} {one['vehicle']}", *figures(one)] for one in vehicles]
        for line in lines or [["no vehicle"]]:
            print(" | ".join([str(name), str(done.exit_code), *line]), flush=True)


if __name__ == "__main__":
    main()
