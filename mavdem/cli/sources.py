"""Sources of a command: reading, assessing and naming the logs that its SOURCE arguments name."""

from collections.abc import Callable, Mapping, Sequence, Sized
from filecmp import cmp
from itertools import combinations
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

import click

from mavdem.assessment.assess import assess_recording, assess_signals
from mavdem.assessment.axis import Options
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.record import Assessment
from mavdem.assessment.separate_flights import separate_flights
from mavdem.cli.links import refuse_link
from mavdem.cli.output import progress
from mavdem.cli.streams import escape_unprintable, print_to_stderr
from mavdem.dataset.axes import AXES
from mavdem.dataset.flights import choose_vehicle, learnable_flight
from mavdem.dataset.signals import Signals
from mavdem.errors import NotLearnable, Unreadable
from mavdem.facts import Fact
from mavdem.facts.command import NamedSource
from mavdem.flight import Flight
from mavdem.ingest import Log, read_log
from mavdem.ingest.joined import join_logs
from mavdem.ingest.parameter_file import with_parameters
from mavdem.report.templates import render_section

Result = TypeVar("Result")
"""What a function makes of a flight."""


class FlightResults(NamedTuple, Generic[Result]):
    """Results of a function for the flights of several logs, and the logs that have none."""

    results: dict[str, Result]
    """Results by the flight's name; at least one."""

    excluded: dict[str, NotLearnable | Unreadable]
    """Reason why a log has no result, by its path; it is also on standard error."""


def read_source(source: str, params: Path | None = None) -> Log:
    """Reads the log that a SOURCE names, and shows on standard error that it is being read.

    Args:
        source: Path of the log.
        params: File with parameters of the autopilot, for those that the log does not have.

    Returns:
        The log, with the parameters of the file added.

    Raises:
        Unreadable: SOURCE is a link, or a file that cannot be read.
    """
    refuse_link(source)
    with progress(f"Reading {source}", measured=False):
        log = read_log(source)
    if params is None:
        return log
    return with_parameters(log, params)


def read_sources(sources: Sequence[str], params: Path | None = None) -> Log:
    """Reads the logs of one flight that SOURCE arguments name, joined to one log.

    Args:
        sources: Paths of the logs, at least one.
        params: File with parameters of the autopilot, for those that the logs do not have.

    Returns:
        The joined log, with the parameters of the file added.

    Raises:
        click.BadParameter: A log is named twice.
        Unreadable: A log cannot be read, or the logs are not of one flight.
    """
    refuse_repeated_sources(sources)
    log = join_logs([read_source(source) for source in sources])
    if params is None:
        return log
    return with_parameters(log, params)


def refuse_repeated_sources(sources: Sequence[str]) -> None:
    """Raises ``click.BadParameter`` where a log is named twice, also by another path or by a copy of its file."""
    for first, second in combinations(sources, 2):
        if first == second or _have_same_content(first, second):
            raise click.BadParameter(
                f"{second} is the same log as {first}: each flight counts once.",
                param_hint="SOURCE",
            )


def _have_same_content(first: str, second: str) -> bool:
    """Returns whether two paths lead to files of the same bytes; false if one of them is no file that can be read."""
    paths = Path(first), Path(second)
    try:
        return all(path.is_file() for path in paths) and cmp(*paths, shallow=False)
    except (OSError, ValueError):
        return False


def assess_without_model(
    source: str,
    vehicle: str | None,
    params: Path | None = None,
    inputs: str | None = None,
    start: float = 0.0,
    *,
    judges_worst_flight: bool = False,
) -> tuple[Assessment, Evidence]:
    """Assesses one vehicle of a log from measurements alone, which is faster than learning the full model first.

    Args:
        source: Path of the log.
        vehicle: Name of the vehicle; it may be None if the log has only one.
        params: File with parameters of the autopilot, for those that the log does not have.
        inputs: Inputs of models, "motors" or "demand"; None for the default.
        start: Time at the beginning of the settled flight that is left out, s.
        judges_worst_flight: Whether flights between which the autopilot restarted on the ground are judged each by
            itself, and the worst is assessed; otherwise all are assessed together.

    Returns:
        The assessment, and the evidence on which it is based.

    Raises:
        Unreadable: The log cannot be read.
        NotLearnable: The log does not have that vehicle.
    """
    log = read_source(source, params)
    signals = Signals(choose_vehicle(log.vehicles, vehicle), inputs=inputs)
    if not judges_worst_flight:
        note_flights_used_together(signals)
    options = Options(inputs=inputs, start=start, with_model=False)
    assess_vehicle = assess_recording if judges_worst_flight else assess_signals
    assessment = assess_vehicle(log, signals, AXES[0], options, progress=progress)
    assert assessment.evidence is not None
    return assessment, assessment.evidence


def note_flights_used_together(signals: Signals) -> None:
    """Prints that all flights of a log are used together, if a review of the log judges them separately.

    Args:
        signals: Signals of the vehicle in all boots.
    """
    flights = separate_flights(signals)
    if flights:
        last_flight = flights[-1]
        count = last_flight.last_number or last_flight.first_number
        for sentence in render_section("flights_used_together", count=count):
            print_to_stderr(sentence.text)


def sources_by_flight_name(sources: Sequence[str]) -> dict[str, str]:
    """Names the flights of several sources.

    Args:
        sources: Paths of logs.

    Returns:
        The path of each log, by the name of its flight: the file's name without its ending or, where several files
        have the same, the whole path. Control characters in names are replaced by escapes.
    """
    stems = [escape_unprintable(Path(source).stem) for source in sources]
    sources_by_name = {}
    for stem, source in zip(stems, sources, strict=True):
        is_unique = stems.count(stem) == 1
        name = stem if is_unique else escape_unprintable(source)
        sources_by_name[name] = source
    return sources_by_name


def map_flights(
    sources: Sequence[str],
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    function: Callable[[str, Flight], Result],
) -> FlightResults[Result]:
    """Applies a function to the longest settled flight of each log.

    A log that cannot be used is reported on standard error, and left out.

    Args:
        sources: Paths of the logs.
        axis: Axis of the flights.
        vehicle: Name of the vehicle in each log; it may be None if a log has only one.
        inputs: Inputs of the flights, "motors" or "demand"; None for the default.
        function: Function that is called with the name of a flight, and the flight; it may raise ``NotLearnable``.

    Returns:
        Results of the function, and the logs that are left out.

    Raises:
        click.BadParameter: A log is named twice.
        Unreadable, NotLearnable: No log can be used (:func:`report_excluded`).
    """
    refuse_repeated_sources(sources)
    results = {}
    errors: dict[str, NotLearnable | Unreadable] = {}
    for name, source in sources_by_flight_name(sources).items():
        try:
            flight, _ = learnable_flight(read_source(source), axis, vehicle, inputs)
            results[name] = function(name, flight)
        except (NotLearnable, Unreadable) as error:
            errors[source] = error
    report_excluded(results, errors)
    return FlightResults(results, errors)


def report_excluded(results: Sized, errors: Mapping[str, NotLearnable | Unreadable]) -> None:
    """Reports on standard error which flights are left out, and why.

    Args:
        results: Results of the other flights.
        errors: Reason why each flight is left out, by the name to report.

    Raises:
        Unreadable, NotLearnable: There are no results. Of a single flight its own error is raised. Of several each is
            reported, and the error says that none is left: it is ``Unreadable`` only if none of them can be read.
    """
    if not results and len(errors) == 1:
        raise next(iter(errors.values()))
    for name, error in errors.items():
        print_to_stderr(f"mavdem: {name} is left out: {error}")
    if not results:
        nothing_left = Fact(NamedSource.NONE_USABLE, count=len(errors))
        if all(isinstance(error, Unreadable) for error in errors.values()):
            raise Unreadable(nothing_left)
        raise NotLearnable(nothing_left)
