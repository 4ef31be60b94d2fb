"""``mavdem order``: how many states a vehicle's motion has, by the free energy."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from functools import partial
from math import isfinite
from time import perf_counter
from typing import Any

import click

from mavdem.account import Sentence, Table
from mavdem.cli.output import print_json, printable, progress, say, say_aside
from mavdem.cli.several import Refused, check_sources, names_of, nothing_left
from mavdem.cli.source import motion_options, read_source
from mavdem.cli.summary import print_account
from mavdem.dem.many import answer_many
from mavdem.dem.order import LARGEST, MOST_STATES, FlightOrders, OrderChoice, orders_of
from mavdem.errors import NotLearnable, Unreadable
from mavdem.flight import Flight
from mavdem.read import learnable_flight

UNREADABLE = 2
"""Exit code."""


@click.command()
@motion_options
@click.argument("sources", metavar="SOURCE...", type=click.Path(), nargs=-1, required=True)
@click.option(
    "--max-order",
    type=click.IntRange(1, LARGEST),
    default=MOST_STATES,
    show_default=True,
    help="The most states that are tried.",
)
@click.option(
    "--unknown-inputs",
    is_flag=True,
    help="Take the motors for unknown, as the paper's black-box estimation does: η̃ᵛ = 0, P̃ᵛ = e².",
)
@click.pass_context
def order(
    context: click.Context,
    sources: tuple[str, ...],
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    max_order: int,
    unknown_inputs: bool,
) -> None:
    """Finds how many states the motion has, by the free energy.

    Each SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz. Its longest stretch of settled
    flight is learnt with 1, 2, ... states, nothing given of A, B and C and the same priors for each (extended DEM).
    The free energy action rises up to the order that the outputs show, and saturates there; over several flights it is
    averaged, with its spread. What neither motors nor wind move is not counted, and what colours the wind is.

    \b
    Examples:
      mavdem order flight.tlog
      mavdem order one.tlog two.tlog three.tlog --unknown-inputs --json

    A SOURCE that does not tell is named, and the others stand. Ends with 0 when an order was found, with 1 when no
    flight tells one, and with 2 when a SOURCE cannot be read.
    """
    check_sources(sources)
    began = perf_counter()
    flights, refused = _flights(sources, (axis, vehicle, inputs))
    told = _orders(flights, max_order, not unknown_inputs, refused, dict(zip(names_of(sources), sources, strict=True)))
    if not told:
        raise nothing_left(refused, "given an order")
    choice = OrderChoice(tuple(told.values()))
    report = {
        **choice.to_dict(),
        "flights": list(told),
        "axis": axis,
        "known_inputs": not unknown_inputs,
        "refused": [one.values for one in refused],
        "seconds": round(perf_counter() - began, 3),
    }
    if as_json:
        print_json(report)
        for one in refused:
            say_aside(printable(f"mavdem: {one.source} does not tell: {one.error}"))
    else:
        print_account(_account(choice, list(told)))
        for one in refused:
            say(f"{one.name}: does not tell. {one.error}\n")
        say(f"Took {report['seconds']:.1f} s.")
    if any(isinstance(one.error, Unreadable) for one in refused):
        context.exit(UNREADABLE)


def _flights(
    sources: Sequence[str], of_flight: tuple[str, str | None, str | None]
) -> tuple[dict[str, Flight], list[Refused]]:
    """Settled flights by name, as many inputs each, and what is none."""
    found: dict[str, Flight] = {}
    refused = []
    for name, source in zip(names_of(sources), sources, strict=True):
        try:
            flight, _ = learnable_flight(read_source(source), *of_flight)
            inputs = flight.inputs.shape[1]
            first = next(iter(found.values()), flight).inputs.shape[1]
            if inputs != first:
                raise NotLearnable(
                    f"It has {inputs} inputs, and the flights before it {first}.", "Ask for its order by itself."
                )
            found[name] = flight
        except (NotLearnable, Unreadable) as error:
            refused.append(Refused(name, source, error))
    return found, refused


def _orders(
    flights: dict[str, Flight], most: int, known: bool, refused: list[Refused], sources: dict[str, str]
) -> dict[str, FlightOrders]:
    """What each flight tells by name; those that tell nothing are added to the refused."""
    told = {}
    work = partial(_tried, most=most, known=known)
    with (
        progress(f"Learning {len(flights)} flight{'s' * (len(flights) != 1)} with 1 to {most} states") as done,
        closing(answer_many(work, flights.values())) as coming,
    ):
        for number, (name, answer) in enumerate(zip(flights, coming, strict=True), 1):
            if isinstance(answer, ValueError):
                cure = "Record a longer flight, or a livelier one."
                refused.append(Refused(name, sources[name], NotLearnable(f"{str(answer).capitalize()}.", cure)))
            else:
                told[name] = answer
            done(number / len(flights))
    return told


def _tried(flight: Flight, most: int, known: bool) -> FlightOrders | ValueError:
    """What a flight tells, or why it tells nothing."""
    try:
        return orders_of(flight, most, known)
    except ValueError as error:
        return error


def _account(choice: OrderChoice, names: Sequence[str]) -> list[Sentence | Table]:
    several = len(names) > 1
    header = ["states", *names, *(["mean", "spread"] if several else [])]
    highest = choice.free_energy[:, choice.chosen - 1]
    rows = []
    for row, order in enumerate(choice.orders):
        cells = [_nats(value) for value in choice.free_energy[:, row] - highest]
        if several:
            mean, spread = choice.mean[row], choice.spread[row]
            cells += [_nats(mean - choice.mean[choice.chosen - 1]), _nats(spread)]
        rows.append([f"{order}{' (chosen)' if order == choice.chosen else ''}", *cells])
    return [
        Sentence("", lead=choice.reason),
        Table(header, rows),
        Sentence("F̄ in nats, over that of the chosen order; spread is the standard deviation of F̄ over the flights."),
        *(Sentence(remark, "Caution:") for remark in choice.remarks),
    ]


def _nats(value: Any) -> str:
    return f"{value:,.1f}" if isfinite(value) else "-"
