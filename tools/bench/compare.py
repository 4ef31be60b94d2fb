#!/usr/bin/env python
"""DEM and other methods on every window of every recorded flight: how DEM meets its bars, then as `mavdem compare`.

What a method made of a window is kept, and worked out anew only where the method's settings or source have changed.

Usage: tools/bench/compare.py [--settings JSON]... [--without NAME]... [--flight NAME]... [--from-zero] [--json FILE]
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click
from bars import Bars
from bars_account import details, summary
from flights import HOP, SHARED, TEST, TRAIN, recorded_flights
from kept import FOLDER, kept_outcomes
from rich.progress import track

from mavdem import Settings
from mavdem.cli.output import json_text
from mavdem.cli.summary import print_account
from mavdem.comparison import GENERALIZED_COORDINATES, METHODS, Comparison, Method, account, dem
from mavdem.windows import windows

DEM = METHODS[0].name


def of_settings(_context: click.Context, _option: click.Parameter, texts: tuple[str, ...]) -> tuple[Method, ...]:
    try:
        # Named by the values, so that a space typed or left out makes no other method.
        return tuple(
            dem(f"DEM {json.dumps(json.loads(text), sort_keys=True)}", Settings.from_json(text)) for text in texts
        )
    except (ValueError, TypeError) as error:
        raise click.BadParameter(f"{error}.") from None


@click.command(help=__doc__)
@click.option(
    "--settings",
    "tried",
    multiple=True,
    callback=of_settings,
    help='One more method: DEM with these changes to the default settings, such as {"order": 2}.',
)
@click.option(
    "--without",
    multiple=True,
    type=click.Choice([one.name for one in METHODS[1:]]),
    help="Leave this method out.",
)
@click.option("--flight", "chosen", multiple=True, help="Only flights whose name begins so.")
@click.option("--from-zero", is_flag=True, help="Begin forecasts with state 0.")
@click.option(
    "--kept",
    type=click.Path(file_okay=False, path_type=Path),
    default=FOLDER,
    show_default=True,
    help="Folder in which outcomes are kept; it may be deleted at any time.",
)
@click.option("--json", "to", type=click.Path(path_type=Path), help="Also write the document there.")
def main(
    tried: tuple[Method, ...],
    without: tuple[str, ...],
    chosen: tuple[str, ...],
    from_zero: bool,
    kept: Path,
    to: Path | None,
) -> None:
    cut = [
        window
        for name, flight in recorded_flights()
        if not chosen or name.startswith(chosen)
        for window in windows(name, flight, TRAIN, TEST, HOP)
    ]
    if not cut:
        sys.exit(f"There are no such flights in {SHARED}; name their folder in MAVDEM_SHARED_DATA.")
    methods = [*(one for one in METHODS if one.name not in without), *tried]
    try:
        found = list(track(kept_outcomes(kept, cut, methods), total=len(cut) * len(methods), description="Comparing"))
    except OSError as error:
        sys.exit(f"Outcomes cannot be kept in {kept}: {error}. Name another folder with --kept.")
    order = [one.name for one in methods]
    compared = Comparison.of(cut, sorted(found, key=lambda one: order.index(one.method)))
    bars = [_bars(compared, one) for one in (DEM, *(method.name for method in tried))]
    print_account(block for told in (summary, details) for one in bars for block in told(one))
    print_account(account(compared, from_zero))
    if to:
        document = {"bars": [one.to_dict() for one in bars], **compared.to_dict(from_zero)}
        to.write_text(json_text(document) + "\n")


def _bars(compared: Comparison, method: str) -> Bars:
    counterpart = dict(GENERALIZED_COORDINATES).get(method)
    return Bars(compared, method, counterpart if counterpart in compared.methods else None)


if __name__ == "__main__":
    main()
