#!/usr/bin/env python
"""DEM and other methods on every window of every recorded flight: a summary by horizon, then as `mavdem compare`.

Usage: tools/bench/compare.py [--settings JSON]... [--without NAME]... [--flight NAME]... [--from-zero] [--json FILE]
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from rich.progress import track

from mavdem import Settings
from mavdem.cli.output import json_text, print_blocks
from mavdem.comparison import GENERALIZED_COORDINATES, METHODS, PEERS, Comparison, Method, Outcome, dem, outcomes
from mavdem.evaluate.flight_windows import Window, windows
from mavdem.paper.flights import HOP, SHARED, TEST, TRAIN, recorded_flights
from mavdem.report.blocks import Table
from mavdem.report.comparison import comparison_report

Array = NDArray[np.float64]

LARGE_VARIANCE = 0.5  # expected squared error over the training variance: a forecast that expects more is flagged


def summary(compared: Comparison, method: str) -> Table:
    """How a method compares with the others and with the constant mean, by horizon."""
    outcomes_of = {name: [row[i] for row in compared.outcomes] for i, name in enumerate(compared.methods)}
    own = outcomes_of[method]
    steps = [skill.steps for skill in own[0].skill]
    relative = {
        name: np.array([[one.relative for one in each.skill] for each in found]) for name, found in outcomes_of.items()
    }  # (windows, horizons)
    flights = np.array([window.flight for window in compared.windows])
    medians = {
        name: np.array([np.median(errors[flights == flight], axis=0) for flight in compared.flights])
        for name, errors in relative.items()
    }  # (flights, horizons)
    peers = [medians[peer.name] for peer in PEERS if peer.name in medians]
    worse = relative[method] > 1
    flagged = np.array([_flagged(*pair, steps) for pair in zip(compared.windows, own, strict=True)])
    inside = np.array([_inside(*pair) for pair in zip(compared.windows, own, strict=True)])
    rows: list[tuple[str, Array, str]] = []
    if peers:
        best = np.min(peers, axis=0)
        rows.append(
            ("median error over the best peer's on each flight", _geometric_mean(medians[method] / best), ".3g")
        )
        single = np.max([_geometric_mean(medians[method] / peer) for peer in peers], axis=0)
        rows.append(("median error over the best single peer's", single, ".3g"))
    without = dict(GENERALIZED_COORDINATES).get(method)
    if without in medians:
        rows.append((f"flights better than {without}", (medians[method] < medians[without]).mean(axis=0), ".0%"))
    with np.errstate(invalid="ignore"):
        rows += [
            ("windows worse than the constant mean", worse.mean(axis=0), ".1%"),
            ("flagged of those", (flagged & worse).sum(axis=0) / worse.sum(axis=0), ".0%"),
            ("flagged of the others", (flagged & ~worse).sum(axis=0) / (~worse).sum(axis=0), ".0%"),
        ]
    rows.append(("worst window over the constant mean", relative[method].max(axis=0), ".3g"))
    rows.append(("sample k in the 90 % band", np.nanmean(inside[:, np.array(steps) - 1], axis=0), ".0%"))
    return Table(
        [f"{method}, after steps", *map(str, steps)],
        [[name, *("" if np.isnan(value) else f"{value:{shown}}" for value in values)] for name, values, shown in rows],
    )


def _geometric_mean(ratios: Array) -> Array:
    """(horizons,): over flights."""
    return np.asarray(np.exp(np.log(ratios).mean(axis=0)))


def _flagged(window: Window, outcome: Outcome, steps: list[int]) -> NDArray[np.bool_]:
    """(horizons,): whether the model has a caution, or expects a large error over the first k samples."""
    if outcome.expected is None:
        return np.full(len(steps), bool(outcome.cautions))
    share = outcome.expected / window.train.outputs.var(axis=0)
    return np.array([bool(outcome.cautions) or share[:k].mean() > LARGE_VARIANCE for k in steps])


def _inside(window: Window, outcome: Outcome) -> Array:
    """(H,) share of outputs in the 90 % band, by sample; NaN without a band."""
    measured = window.test.outputs
    if outcome.band is None or outcome.forecast is None:
        return np.full(len(measured), np.nan)
    return np.asarray((np.abs(measured - outcome.forecast) <= outcome.band).mean(axis=1))


def of_settings(_context: click.Context, _option: click.Parameter, texts: tuple[str, ...]) -> tuple[Method, ...]:
    """The methods of ``--settings``, named by their values."""
    try:
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
    "--without", multiple=True, type=click.Choice([one.name for one in METHODS[1:]]), help="Leave this method out."
)
@click.option("--flight", "chosen", multiple=True, help="Only flights with names that begin so.")
@click.option("--from-zero", is_flag=True, help="Begin forecasts with state 0.")
@click.option("--json", "to", type=click.Path(path_type=Path), help="Also write the document there.")
def main(
    tried: tuple[Method, ...], without: tuple[str, ...], chosen: tuple[str, ...], from_zero: bool, to: Path | None
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
    found = list(track(outcomes(cut, methods), total=len(cut) * len(methods), description="Comparing"))
    compared = Comparison.of(cut, found)
    print_blocks(summary(compared, name) for name in (METHODS[0].name, *(method.name for method in tried)))
    print_blocks(comparison_report(compared, from_zero))
    if to:
        to.write_text(json_text(compared.to_dict(from_zero)) + "\n")


if __name__ == "__main__":
    main()
