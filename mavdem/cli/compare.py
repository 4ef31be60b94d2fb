"""``mavdem compare``: forecasts of mavdem and of other methods on the same windows of one or several logs."""

from collections.abc import Callable, Sequence
from contextlib import closing
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import click

from mavdem.cli.exit_codes import EXIT_DONE, EXIT_INTERRUPTED
from mavdem.cli.options import (
    WholeNumberRange,
    file_option,
    motion_options,
    sources_argument,
    verbose_option,
    window_options,
)
from mavdem.cli.output import print_result, progress_bar
from mavdem.cli.output_files import check_output_folder, write_texts
from mavdem.cli.sources import map_flights, sources_by_flight_name
from mavdem.cli.streams import print_to_stderr, stderr_is_terminal
from mavdem.containers import Names
from mavdem.dem.parallel import workers_for
from mavdem.experiments.compared_methods import METHODS, STANDARD_METHODS, Method
from mavdem.experiments.comparison import (
    WindowOutcomes,
    comparison_of_outcomes,
    outcomes_by_window,
)
from mavdem.experiments.outcomes import Outcome
from mavdem.experiments.run_time import RunTimeEstimate
from mavdem.experiments.window import (
    MAX_WINDOWS,
    TRAIN_SECONDS,
    Length,
    Window,
    required_windows,
)
from mavdem.report.comparison import comparison_report, plan_report
from mavdem.report.numbers import listed
from mavdem.report.pages.methods_page import methods_page
from mavdem.report.templates import render_section

PAGE_FILE = "compare.html"
"""Name of the page with the error of each method by horizon, and all tables."""

ALL_METHODS = "all"
"""What --methods takes in the place of names for all methods."""

SECONDS_BETWEEN_LINES = 10.0
"""Time between two lines of progress in a file or a pipe, s; a choice. A shorter run prints none."""


def _methods_from_text(
    context: click.Context, parameter: click.Parameter, text: str | None
) -> Sequence[Method]:
    """Returns the methods that a user has named; Click's callback for --methods.

    Args:
        context: Click's context of the command that is parsed.
        parameter: The option.
        text: Names of methods between commas, in capital or small letters, or "all"; None for the usual methods.

    Raises:
        click.BadParameter: A name is that of no method, or there are not two methods to compare.
    """
    if text is None:
        return STANDARD_METHODS
    if text.strip().lower() == ALL_METHODS:
        return METHODS
    methods_by_name = {method.name.lower(): method for method in METHODS}
    chosen_methods: list[Method] = []
    for given_name in text.split(","):
        name = given_name.strip()
        method = methods_by_name.get(name.lower())
        if method is None:
            raise click.BadParameter(_unknown_method_text(name))
        if method not in chosen_methods:
            chosen_methods.append(method)
    if len(chosen_methods) == 1:
        raise click.BadParameter("it takes two methods or more, with commas between them.")
    return chosen_methods


def _unknown_method_text(name: str) -> str:
    """Returns the error for an unknown method: which methods there are, and perhaps the one that was meant.

    An example: "'arxx' is none of arx, dem and hold. Did you mean arx?"
    """
    names = [str(method.name) for method in METHODS]
    names_in_small_letters = {known_name.lower(): known_name for known_name in names}
    similar = get_close_matches(name.lower(), names_in_small_letters, n=1)
    suggestion = f" Did you mean {names_in_small_letters[similar[0]]}?" if similar else ""
    return f"'{name}' is none of {listed(names)}, nor '{ALL_METHODS}'.{suggestion}"


@click.command("compare")
@motion_options()
@sources_argument
@window_options(f"{TRAIN_SECONDS:g}s", "Held-out test data after them: seconds or samples.")
@click.option(
    "--hop",
    type=WholeNumberRange(1),
    help="Samples from one window to the next. [default: half of --train and --test; in a long flight more, "
    f"for {MAX_WINDOWS} windows]",
)
@click.option(
    "--methods",
    metavar="NAME,...",
    callback=_methods_from_text,
    help=f"Methods by their names in the tables, the first of which is compared with the others; or '{ALL_METHODS}', "
    "which takes three times as long. "
    f"[default: {', '.join(method.name for method in STANDARD_METHODS)}]",
)
@file_option("--out", "Folder for compare.html, with the error of each method by horizon.")
@verbose_option
def compare_command(
    sources: Names,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    train: Length | None,
    test: Length | None,
    hop: int | None,
    methods: Sequence[Method],
    out: Path | None,
    verbose: bool,
) -> None:
    """Compares forecasts with those of other methods, window by window.

    mavdem forecasts by joint VAR (Bayesian), since its errors are lower; DEM learns the motion, since only its model,
    with the motors as causes, has A, B and C, F(t) and surprise. The rows "DEM ..." are forecasts by that model alone.

    Each SOURCE is a log. Its longest settled flight is cut into windows. In each window every method is trained on
    --train and forecasts the --test samples after them, with the inputs of that time known, and without them by the
    methods that can. The report begins with the methods that have smaller errors than DEM's model and than the first
    method, with the p-values of paired tests, and how far ahead forecasts are useful. A table sums up RMSE, error ratio
    (squared error over that of a constant forecast) and p. With --verbose follow forecasts without the inputs, what
    each figure is, and error ratios at all horizons; --out draws these over the horizon, on a page. A run that is
    stopped, as by Ctrl-C, reports the windows that are done.

    In --json an error that is infinite, or of a missing forecast, is null; it has each flight and window.

    \b
    Examples:
      mavdem compare flight.tlog
      mavdem compare flight.tlog --methods "DEM plant,PEM(4),hold last"
      mavdem compare flight.tlog --methods all --out compared
      mavdem compare one.tlog two.ulg --json > comparison.json

    A SOURCE that cannot be compared is reported, and the others are compared. Exit code: 0 if a flight was compared,
    1 if none was, 2 if no SOURCE can be read.
    """
    if out is not None:
        check_output_folder(out, (PAGE_FILE,), *sources)
    start_time = perf_counter()
    flights = map_flights(
        sources,
        axis,
        vehicle,
        inputs,
        partial(required_windows, train=train, test=test, hop=hop),
    )
    windows: list[Window] = []
    for windows_of_flight in flights.results.values():
        windows += windows_of_flight
    for sentence in plan_report(windows, methods, workers_for(len(windows) * len(methods))):
        print_to_stderr(f"{sentence.lead} {sentence.text}")
    run = _compare_until_stopped(windows, methods)
    comparison = comparison_of_outcomes(windows, methods, run.outcomes)
    left_out: dict[str, Exception] = {**flights.excluded}
    for name, source in sources_by_flight_name(sources).items():
        if name in flights.results and name not in comparison.flights:
            left_out[source] = RuntimeError("the run was stopped before this log was reached.")
    seconds = round(perf_counter() - start_time, 3)
    compared_sources = {
        name: source
        for name, source in sources_by_flight_name(sources).items()
        if name in comparison.flights
    }
    document = {
        **comparison.to_dict(),
        "axis": axis,
        "sources": compared_sources,
        "seconds": seconds,
        "planned_windows": len(windows),
        "left_out": {source: str(error) for source, error in left_out.items()},
    }
    is_complete = len(run.outcomes) == len(windows)
    planned_windows = None if is_complete else len(windows)
    if out is not None:
        write_texts(out, {PAGE_FILE: methods_page(comparison, planned_windows, left_out)})
    report = comparison_report(comparison, planned_windows, left_out, verbose=verbose)
    print_result(document, report, as_json=as_json)
    print_to_stderr(f"Took {seconds:.1f} s.")
    if out is not None:
        print_to_stderr(f"Page: {out / PAGE_FILE}")
    if run.exit_code != EXIT_DONE:
        raise click.exceptions.Exit(run.exit_code)


class _Run(NamedTuple):
    """The windows that a run has compared, all or those before it was stopped."""

    outcomes: list[WindowOutcomes]
    """Outcomes of all methods in each window that is done; at least one."""

    exit_code: int
    """0 if the run came to its end, otherwise the exit code of the signal that stopped it."""


def _compare_until_stopped(windows: Sequence[Window], methods: Sequence[Method]) -> _Run:
    """Runs all methods on all windows, or on as many as are done when Ctrl-C or another signal stops the run.

    Args:
        windows: windows of one flight or several, at least one.
        methods: methods to compare.

    Returns:
        The outcomes, and how the run ended.

    Raises:
        KeyboardInterrupt, SystemExit: the run was stopped before the first window was done.
    """
    outcomes: list[WindowOutcomes] = []
    with progress_bar("Comparing") as show_bar:
        show_progress = _ComparisonProgress(methods, windows, show_bar)
        try:
            with closing(outcomes_by_window(windows, methods, show_progress)) as window_outcomes:
                for outcomes_of_window in window_outcomes:
                    outcomes.append(outcomes_of_window)
        except (KeyboardInterrupt, SystemExit) as stop:
            if not outcomes:
                raise
            return _Run(outcomes, _exit_code(stop))
    return _Run(outcomes, EXIT_DONE)


def _exit_code(stop: KeyboardInterrupt | SystemExit) -> int:
    """Returns the exit code of a command that a signal has stopped: 130 for Ctrl-C, otherwise that of the signal."""
    if isinstance(stop, SystemExit) and isinstance(stop.code, int):
        return stop.code
    return EXIT_INTERRUPTED


class _ComparisonProgress:
    """Shows how far a comparison is, which method is in work in which window and, once a window is done, the time left.

    A terminal has a bar with a title. A file or a pipe gets a line after ``SECONDS_BETWEEN_LINES``, and then as often.
    """

    def __init__(
        self,
        methods: Sequence[Method],
        windows: Sequence[Window],
        show_bar: Callable[[float, str], None],
    ) -> None:
        """Estimates the run time by typical times, and measures the time to the first printed line from now on.

        Args:
            methods: methods to compare.
            windows: windows to compare.
            show_bar: function that shows a bar, filled by a fraction from 0 to 1, with a title beside it.
        """
        self._methods = methods
        self._window_count = len(windows)
        self._trial_count = len(methods) * len(windows)
        self._done_count = 0
        self._show_bar = show_bar
        self._run_time = RunTimeEstimate(methods, windows, workers_for(self._trial_count))
        self._last_line_time = perf_counter()
        # Start of the first trial; the time before it is that in which the workers start.
        self._start_time: float | None = None

    def __call__(self, outcome: Outcome) -> None:
        """Counts the outcome of one method in one window as done, and shows the progress.

        Args:
            outcome: the outcome, with the time that it took.
        """
        time = perf_counter()
        self._done_count += 1
        self._run_time.add(outcome)
        if self._start_time is None:
            self._start_time = time - outcome.elapsed_seconds
        if self._done_count == self._trial_count:
            return
        elapsed_seconds = time - self._start_time
        seconds_left = None
        share = self._done_count / self._trial_count
        # The methods take very different times, and the first trial of each process loads libraries: before all methods
        # are done in a window, no time is known.
        if self._done_count >= len(self._methods):
            seconds_left = self._run_time.seconds_left(elapsed_seconds)
            share = elapsed_seconds / (elapsed_seconds + seconds_left)
        text = self._progress_text(share, seconds_left)
        self._show_bar(share, text)
        is_line_due = time - self._last_line_time >= SECONDS_BETWEEN_LINES
        if is_line_due and not stderr_is_terminal():
            print_to_stderr(f"{text}.")
            self._last_line_time = time

    def _progress_text(self, share: float, seconds_left: float | None) -> str:
        """Returns how far the comparison is, which method is in work in which window, and the time left.

        Args:
            share: part of the run that is done, from 0 to 1.
            seconds_left: estimate of the time left, s; None while it is not known.
        """
        # Outcomes come in the order of the trials: the next one is in work, and perhaps later ones on other cores.
        window_index, method_index = divmod(self._done_count, len(self._methods))
        [progress] = render_section(
            "comparison_progress",
            method=self._methods[method_index].name,
            window=window_index + 1,
            windows=self._window_count,
            share=share,
            seconds_left=seconds_left,
            slow_method=self._run_time.slow_method(),
        )
        return progress.text
