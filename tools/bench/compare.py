#!/usr/bin/env python
"""DEM and other methods on every window of every recorded flight, as `mavdem compare` does; where DEM loses first.

Usage: tools/bench/compare.py [--flight NAME]... [--from-zero] [--json FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

import click
from flights import HOP, SHARED, TEST, TRAIN, recorded_flights
from rich.progress import track

from mavdem.cli.output import json_text
from mavdem.cli.summary import print_account
from mavdem.comparison import METHODS, Comparison, account, outcomes
from mavdem.windows import windows


@click.command(help=__doc__)
@click.option("--flight", "chosen", multiple=True, help="Only flights whose name begins so.")
@click.option("--from-zero", is_flag=True, help="Begin forecasts with state 0.")
@click.option("--json", "to", type=click.Path(path_type=Path), help="Also write the document there.")
def main(chosen: tuple[str, ...], from_zero: bool, to: Path | None) -> None:
    cut = [
        window
        for name, flight in recorded_flights()
        if not chosen or name.startswith(chosen)
        for window in windows(name, flight, TRAIN, TEST, HOP)
    ]
    if not cut:
        sys.exit(f"There are no such flights in {SHARED}; name their folder in MAVDEM_SHARED_DATA.")
    compared = Comparison.of(cut, track(outcomes(cut), total=len(cut) * len(METHODS), description="Comparing"))
    print_account(account(compared, from_zero))
    if to:
        to.write_text(json_text(compared.to_dict(from_zero)) + "\n")


if __name__ == "__main__":
    main()
