"""``mavdem order``: the choice of the model order (number of states) by the free energy (extended DEM)."""

from dataclasses import dataclass
from time import perf_counter

import click

from mavdem.cli.options import WholeNumberRange, motion_options, sources_argument
from mavdem.cli.output import print_result, progress
from mavdem.cli.sources import map_flights, report_excluded
from mavdem.cli.streams import print_to_stderr
from mavdem.containers import Names
from mavdem.dem.order_choice import (
    DEFAULT_MAX_ORDER,
    LARGEST_ORDER,
    OrderChoice,
    free_energy_of_flights,
)
from mavdem.documents.comparison import Order
from mavdem.errors import NotLearnable
from mavdem.facts.command import NamedSource
from mavdem.flight import Flight
from mavdem.report.comparison import order_advice, order_report
from mavdem.report.numbers import counted


@click.command("order")
@motion_options()
@sources_argument
@click.option(
    "--max-order",
    type=WholeNumberRange(1, LARGEST_ORDER),
    default=DEFAULT_MAX_ORDER,
    show_default=True,
    help="The largest number of states to try.",
)
@click.option(
    "--unknown-inputs",
    is_flag=True,
    help="Treat the motors as unknown inputs, as the paper's black-box estimation does: η̃ᵛ = 0, P̃ᵛ = e².",
)
def order_command(
    sources: Names,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    max_order: int,
    unknown_inputs: bool,
) -> None:
    """Finds the model order (number of states) by the free energy.

    Each SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz. Models with 1, 2, ... states are
    trained on its longest settled flight, with A, B and C free and the same priors for each order (extended DEM). The
    free energy action F̄ increases up to the order that the outputs show, and saturates there. Over several flights F̄ is
    averaged, and its spread is reported. States that neither the motors nor the wind excite are not counted; wind that
    changes slowly may count as one.

    \b
    Examples:
      mavdem order flight.tlog
      mavdem order one.tlog two.tlog three.tlog --unknown-inputs --json

    A SOURCE without an order is reported, and the others are used. Exit code: 0 if an order was found, 1 if no flight
    has one, 2 if no SOURCE can be read.
    """
    start_time = perf_counter()
    known_inputs = not unknown_inputs
    flights = map_flights(sources, axis, vehicle, inputs, _InputCountCheck()).results
    title = f"Learning {counted(len(flights), 'flight')}, 1 to {max_order} states"
    with progress(title) as show_fraction:
        free_energies, errors = free_energy_of_flights(
            flights, max_order, known_inputs=known_inputs, progress=show_fraction
        )
    report_excluded(free_energies, errors)
    choice = OrderChoice(tuple(free_energies.values()))
    names = list(free_energies)
    seconds = round(perf_counter() - start_time, 3)
    document = Order.from_results(
        choice,
        flights=names,
        axis=axis,
        known_inputs=known_inputs,
        seconds=seconds,
        advice=order_advice(choice, known_inputs),
        width=[flight.kernel_width for flight in choice.flights],
        samples=[flight.effective_samples for flight in choice.flights],
    )
    print_result(document, order_report(choice, names, known_inputs), as_json=as_json)
    print_to_stderr(f"Took {seconds:.1f} s.")


@dataclass
class _InputCountCheck:
    """Lets flights pass that have as many inputs as the first one.

    The free energies of several flights are averaged, so their models must have the same inputs.
    """

    required_count: int | None = None
    """Number of inputs of the first flight; None before it."""

    def __call__(self, name: str, flight: Flight) -> Flight:
        """Returns the flight unchanged.

        Args:
            name: name of the log, which :func:`map_flights` gives to every function; it is not used.
            flight: the flight of that log.

        Raises:
            NotLearnable: the flight has another number of inputs than the first one.
        """
        count = flight.inputs.shape[1]
        if self.required_count is None:
            self.required_count = count
        if count != self.required_count:
            raise NotLearnable(
                NamedSource.AS_MANY_INPUTS_NEEDED, count=count, needed=self.required_count
            )
        return flight
