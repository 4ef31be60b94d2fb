"""``mavdem diff``: which figures of a vehicle differ significantly between two flights, or two fleets."""

from collections.abc import Callable, Mapping
from datetime import date
from pathlib import Path

import click

from mavdem.cli.exit_codes import EXIT_UNSUPPORTED
from mavdem.cli.links import refuse_link
from mavdem.cli.options import Command, file_option, json_option, verbose_option
from mavdem.cli.output import (
    json_text,
    print_blocks,
    print_json,
    print_screen,
    progress,
    report_error,
)
from mavdem.cli.output_files import check_output_folder, write_texts
from mavdem.cli.result_folders import available_folder
from mavdem.dataset.signals import Signals
from mavdem.documents.fleet import Diff
from mavdem.errors import NotLearnable
from mavdem.facts.fleet import Incomparable
from mavdem.facts.vehicle import GENERIC_FRAME
from mavdem.fleet.common_flights import separate_states
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.report_columns import value_at
from mavdem.fleet.state import (
    Days,
    VehicleState,
    state_of,
    states_of_common_vehicle,
    with_motors_judged,
)
from mavdem.fleet.stored_rows import is_fleet
from mavdem.ingest import read_log
from mavdem.report.blocks import Block, Sentence
from mavdem.report.charts.comparison_charts import FlightSeries, flight_series
from mavdem.report.difference.changes import (
    change_sentences,
    detail_sentences,
    undetected_change_table,
)
from mavdem.report.difference.conditions import condition_sentence, condition_table
from mavdem.report.difference.flight_cautions import flight_cautions
from mavdem.report.difference.headline import (
    headline_blocks,
    headline_in_two_sizes,
    headline_of_comparison,
)
from mavdem.report.difference.identity import identity_remarks
from mavdem.report.difference.lights import sentences_on_further_watched_lights
from mavdem.report.difference.motors import motor_table
from mavdem.report.difference.next_step import next_step_sentences
from mavdem.report.difference.parameters import (
    changed_parameter_sentences,
    parameter_blocks,
    parameter_count_sentences,
)
from mavdem.report.difference.reviewed import (
    ComparedState,
    ReviewedDifference,
    compared_states,
)
from mavdem.report.difference.sides import side_descriptions
from mavdem.report.fleet import kind_of_vehicle
from mavdem.report.pages.difference_page import comparison_page
from mavdem.report.templates import render_section

UNSPECIFIC_FRAMES = ("UNKNOWN", GENERIC_FRAME, "GENERIC_MULTIROTOR")
"""Types of frames that logs state which do not know the frame."""

PAGE_FILE = "diff.html"
"""Name of the page that shows both states together."""

DOCUMENT_FILE = "diff.json"
"""Name of the file with the document, as ``--json`` prints it."""


def _parsed_days(
    context: click.Context, parameter: click.Parameter, text: str | None
) -> Days | None:
    """Parses the days that a user has given; Click's callback for --days-a and --days-b.

    Args:
        context: Click's context of the command that is parsed.
        parameter: The option.
        text: First and last day, as in "2026-01-05..2026-01-11", or a single day; None if the option was not given.

    Returns:
        The first and the last day, both included; None without the option.

    Raises:
        click.BadParameter: They are no dates, or the last one is before the first.
    """
    if text is None:
        return None
    # A single day is its own last day.
    first_text, separator, last_text = text.partition("..")
    is_single_day = not separator
    try:
        first_day = date.fromisoformat(first_text)
        last_day = first_day if is_single_day else date.fromisoformat(last_text)
    except ValueError:
        message = f"{text} is not like 2026-01-05..2026-01-11."
        raise click.BadParameter(message, context, parameter) from None
    if last_day < first_day:
        raise click.BadParameter(f"{last_day} is before {first_day}.", context, parameter)
    return Days(first_day, last_day)


def _days_option(side: str) -> Callable[[Command], Command]:
    """Returns a decorator that adds the option for the days of a side, "a" or "b".

    Args:
        side: Name of the side, "a" or "b".
    """
    return click.option(
        f"--days-{side}",
        metavar="FIRST..LAST",
        callback=_parsed_days,
        help=f"Only flights of {side.upper()} that began on these days, UTC.",
    )


@click.command("diff")
@click.argument("before", metavar="A", type=click.Path())
@click.argument("after", metavar="B", type=click.Path())
@click.option(
    "--vehicle",
    metavar="NAME",
    help="Which vehicle, by its name in the fleet or, in a log with several, SYSTEM:COMPONENT.",
)
@_days_option("a")
@_days_option("b")
@file_option("--out", "Folder for diff.html and diff.json. [default: named after A and B]")
@verbose_option
@json_option
@click.pass_context
def diff_command(
    context: click.Context,
    before: str,
    after: str,
    vehicle: str | None,
    days_a: Days | None,
    days_b: Days | None,
    out: Path | None,
    verbose: bool,
    as_json: bool,
) -> None:
    """Reports what changed between A and B, and what did not.

    A and B are each a log, or a FLEET of `mavdem track`. Of a FLEET all flights of the vehicle count, and show how much
    one flight differs from the next. For single flights that spread is assumed, and the report says so.

    Compared are each motor's relative trim and its control effectiveness, rate damping, motor time constant and
    margins. They are tested in three groups, trims, physical parameters and loops, so that of the changes found in a
    group at most one in twenty is expected to be wrong, on average over these groups. Wind, battery and payload are
    conditions: they widen the intervals.
    Loops with other gains are not tested, but named with the gains.

    \b
    Examples:
      mavdem diff monday.tlog friday.tlog
      mavdem diff fleet_2025/ fleet_2026/ --vehicle px4-1a2b3c
      mavdem diff fleet/ fleet/ --days-a 2026-01-05..2026-01-11 --days-b 2026-01-12..2026-01-18

    A page shows both over each other: step responses, spectra, margins, motors, wind and parameters.

    Exit codes: 0 compared, whatever changed; 1 nothing can be compared; 2 bad usage, or unreadable input.
    """
    folder = out
    if folder is None:
        name = f"{Path(before).stem}_and_{Path(after).stem}"
        folder = available_folder(name, DOCUMENT_FILE, {"a": before, "b": after})
    check_output_folder(folder, (PAGE_FILE, DOCUMENT_FILE), before, after)
    name_a, name_b = STATE_NAMES
    try:
        state_a = _read_state(name_a, before, vehicle, days_a)
        state_b = _read_state(name_b, after, vehicle, days_b)
    except NotLearnable as refusal:
        if refusal.fact.code is Incomparable.NO_FLIGHT and not as_json:
            # The reason comes first: parameters are only what can be compared all the same.
            report_error(refusal.fact, as_json=False)
            _print_parameters_without_flight(Path(before), Path(after), verbose=verbose)
            context.exit(EXIT_UNSUPPORTED)
        raise
    if vehicle is None:
        state_a, state_b = states_of_common_vehicle(state_a, state_b)
    separate = separate_states(state_a, state_b)
    state_a, state_b = with_motors_judged(separate.before, separate.after)
    reviewed = compared_states(
        ComparedState(state_a.rows, state_a.review, state_a.parameters),
        ComparedState(state_b.rows, state_b.review, state_b.parameters),
    )
    difference = reviewed.difference
    states = dict(zip(STATE_NAMES, (state_a, state_b), strict=True))
    fleet_sides = [side for side, state in states.items() if not state.vehicles]
    reviewed = reviewed._replace(
        tracked_sides=tuple(fleet_sides),
        common_files=separate.common_files,
        counting_side=separate.counting_state,
    )
    # A fleet has no reviews, but the headline of each flight.
    headlines = {
        side: value_at(review, "headline.sentence") or states[side].headline
        for side, review in reviewed.reviews.items()
    }
    document = Diff.from_results(
        difference,
        a=before,
        b=after,
        parameters=reviewed.parameters,
        common_files=list(reviewed.common_files),
        headlines={side.lower(): headline for side, headline in headlines.items()},
        motor_health={
            side.lower(): review.get("motor_health") for side, review in reviewed.reviews.items()
        },
    )
    if difference.is_of_same_flight:
        # Nothing can differ, so that there is nothing to keep.
        if as_json:
            print_json(document)
        else:
            print_screen([], [], [], headline_of_comparison(reviewed), verbose=verbose)
        return
    names = (_shown_name(before, days_a), _shown_name(after, days_b))
    page = comparison_page(
        names, reviewed, flights=(_flight_series(state_a), _flight_series(state_b))
    )
    write_texts(folder, {PAGE_FILE: page, DOCUMENT_FILE: json_text(document)})
    if as_json:
        print_json(document)
    else:
        _print_comparison(names, reviewed, headlines, folder / PAGE_FILE, verbose=verbose)
    # That a motor failed in one of the flights is a result, though its figures then cannot be compared.
    has_failed_motor = any(row.failed_motor is not None for row in (*state_a.rows, *state_b.rows))
    if not difference.changes and not has_failed_motor:
        context.exit(EXIT_UNSUPPORTED)


def _print_parameters_without_flight(before: Path, after: Path, *, verbose: bool) -> None:
    """Prints how the parameters of two logs differ of which one has no flight: these can be compared all the same.

    Nothing is printed for a fleet, for logs of several vehicles or of two autopilots, and where a log has no
    parameters.

    Args:
        before: path of log A.
        after: path of log B.
        verbose: whether to print all that changed, and not only those of control.

    Raises:
        Unreadable: A log cannot be read.
    """
    if is_fleet(before) or is_fleet(after):
        return
    vehicles_before = read_log(before).vehicles
    vehicles_after = read_log(after).vehicles
    if len(vehicles_before) != 1 or len(vehicles_after) != 1:
        return
    vehicle_before, vehicle_after = vehicles_before[0], vehicles_after[0]
    have_parameters = vehicle_before.parameters and vehicle_after.parameters
    if not have_parameters or vehicle_before.autopilot != vehicle_after.autopilot:
        return
    frames = []
    for vehicle in (vehicle_before, vehicle_after):
        if vehicle.vehicle not in UNSPECIFIC_FRAMES:
            frames.append(kind_of_vehicle("", vehicle.vehicle))
    print_blocks(
        [
            *render_section("difference_frames", frames=frames),
            *parameter_blocks(
                compared_states(
                    ComparedState([], {}, vehicle_before.parameters),
                    ComparedState([], {}, vehicle_after.parameters),
                ),
                verbose=verbose,
            ),
        ]
    )


def _print_comparison(
    names: tuple[str, str],
    reviewed: ReviewedDifference,
    headlines: Mapping[str, str | None],
    page: Path,
    *,
    verbose: bool,
) -> None:
    """Prints the headline, what is compared, how it was flown and what changed, then the next step.

    The headline is that of the page.

    Args:
        names: Names of A and B.
        reviewed: Comparison of both, and the reviews of their logs.
        headlines: Headline of the review of each log, by side, "A" and "B".
        page: Path of the page that was written.
        verbose: Whether to print all quantities with their intervals, also those that did not change.
    """
    headline = headline_of_comparison(reviewed)
    title = headline_in_two_sizes(reviewed, headline)
    watched_lights = sentences_on_further_watched_lights(reviewed.reviews, headline)
    title += watched_lights
    for side, description in side_descriptions(names, reviewed).items():
        title.append(Sentence(f"{description}.", f"{side}:"))
    # The cautions say that A and B may be two vehicles, or that means are of several states.
    title += [*identity_remarks(reviewed), *flight_cautions(reviewed)]
    if not verbose:
        # The details have a table in its place.
        title += condition_sentence(reviewed)
    title += parameter_count_sentences(reviewed, headline)
    summary: list[Block] = [
        *motor_table(reviewed.reviews, reviewed.difference),
        *change_sentences(reviewed, headline),
        *changed_parameter_sentences(reviewed, headline),
        *undetected_change_table(reviewed),
    ]
    details = [
        *condition_table(reviewed),
        *detail_sentences(reviewed),
        *headline_blocks(headlines, [sentence.text for sentence in (*headline, *watched_lights)]),
    ]
    footer = [*next_step_sentences(reviewed), Sentence(str(page), "Page:")]
    if not verbose:
        footer.insert(
            0, Sentence("`--verbose` prints all figures, and how sure they are.", "More:")
        )
    print_screen(title, summary, details, footer, verbose=verbose)


def _shown_name(source: str, days: Days | None) -> str:
    """Returns the name that the page gives to a log or a fleet: that of its file, with the days that are compared."""
    name = Path(source).name
    if days is None:
        return name
    if days.first == days.last:
        return f"{name}, {days.first}"
    return f"{name}, {days.first} to {days.last}"


def _flight_series(state: VehicleState) -> FlightSeries:
    """Returns the time series of a log's flight; none of a fleet."""
    return {} if state.telemetry is None else flight_series(Signals(state.telemetry))


def _read_state(side: str, source: str, vehicle: str | None, days: Days | None) -> VehicleState:
    """Reads one side of the comparison: the flights of a vehicle in a log or a fleet.

    Args:
        side: Name of the side in error messages, "A" or "B".
        source: Path of the log, or of the fleet's folder.
        vehicle: Name of the vehicle; None for the flights of all vehicles.
        days: Days whose flights count; None for all.

    Raises:
        Unreadable: The log or fleet cannot be read, or ``source`` is the address of a live link.
        NotLearnable: It has no flights of the vehicle.
    """
    refuse_link(source)
    with progress(f"Reading {source}", measured=False):
        return state_of(side, Path(source), vehicle, days)
