"""Bos et al. on hidden states: the roll rate, estimated from the roll by DEM and by Kalman filters for coloured noise.

Their criterion is the sum of squared errors (SSE) of the roll rate in windows of 2 s, without ten samples at each end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import JsonValues
from mavdem.experiments.paper import figures
from mavdem.experiments.paper.checks import Check, ExperimentResult, lists_by_name
from mavdem.experiments.paper.estimation.dem_observer import (
    DEM_STATE_ORDER,
)
from mavdem.experiments.paper.estimation.roll_windows import (
    SIMULATED_SMOOTHNESS,
    TRIM,
    WITH_WIND,
    WITHOUT_WIND,
    RollWindow,
    flight_windows,
    missing_flights_sentence,
    simulated_window,
    wind_of_flight,
)
from mavdem.experiments.paper.estimation.state_observers import (
    AUGMENTATION,
    AUTHORS_SMIKF,
    COMPARED_OBSERVERS,
    DEM,
    DERIVATIVE,
    FIXED_LAG_SMOOTHERS,
    KALMAN,
    OBSERVERS,
    PEERS,
    dem_states,
)
from mavdem.experiments.paper.runner import Runner
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.figures.style import Picture
from mavdem.report.numbers import listed, rounded

OUTLIER_SSE = 100.0
"""SSE, (rad/s)², from which on the authors leave a window out: their SMIKF diverges in some."""

MAX_DELAY = 4
"""Largest delay of the estimates that is tried, samples: 33 ms, beyond what any of the observers needs."""


class PublishedSse(NamedTuple):
    """Mean SSE, (rad/s)², of one observer over the published windows, by Bos et al."""

    with_wind: float
    """Of experiments 21, 22, 24 and 25 with blower."""

    without_wind: float
    """Of the same experiments without it."""


PUBLISHED_SSE = {
    DEM: PublishedSse(0.746, 0.234),
    AUGMENTATION: PublishedSse(0.951, 0.213),
    AUTHORS_SMIKF: PublishedSse(1.62, 0.266),
    KALMAN: PublishedSse(2.75, 0.258),
}
"""Heights of the bars in the authors' figure of state estimation (``Figures/benchmark_bar.eps`` of their repository).

The figure has a logarithmic axis and no numbers; these are read from the coordinates of the file's vector graphics.
"""

PUBLISHED_SSE_BY_ORDER = {1: 2.92, 2: 1.18, 3: 1.13, 4: 1.09, 5: 1.19, 6: 0.746}
"""Mean SSE of DEM with wind by embedding order p, (rad/s)², read from the authors' figure ``Figures/vary_p.eps``.

Order 0, without derivatives, has 17.3 there.
"""

SIMULATED_WINDOWS = 10
"""Number of simulated windows for each smoothness; a choice, with which the run takes some seconds."""


class WindowErrors(NamedTuple):
    """SSE, (rad/s)², of the observers in one window."""

    by_delay: dict[str, Array]
    """(MAX_DELAY + 1,) of each observer, by the samples by which its estimates are delayed."""

    authors_timing: dict[str, float]
    """Of each published observer with the authors' timing, in which an estimate misses its own sample's output."""

    authors_timing_by_order: dict[int, float]
    """Of DEM with that timing, by embedding order p."""


def window_errors(window: RollWindow) -> WindowErrors:
    """Estimates the roll rate of a window with all observers, and sums up their squared errors.

    Bos et al. published errors of estimates that lag by one sample. In their scripts the Kalman filters correct the
    prediction for a sample with the output of the sample before, but use the sample's own input; DEM's embedding is
    centred on the sample before, for outputs and inputs alike. To compare with their numbers, the observers run a
    second time with that timing: all get the outputs one sample late, and DEM the inputs too.

    Args:
        window: outputs, inputs and true or measured states of the window.

    Returns:
        Errors by observer, with estimates at their own time and with the authors' timing.
    """
    errors_by_delay = {}
    for name, observer in OBSERVERS.items():
        # The states are roll and roll rate.
        rates = observer.estimate(window, window.outputs, window.inputs)[:, 1]
        errors = [squared_error(rates, window, delay) for delay in range(MAX_DELAY + 1)]
        errors_by_delay[name] = np.array(errors)
    late_outputs = one_sample_later(window.outputs)
    late_inputs = one_sample_later(window.inputs)
    authors_timing_by_order = {}
    for p in PUBLISHED_SSE_BY_ORDER:
        rates = dem_states(window, late_outputs, late_inputs, p)[:, 1]
        authors_timing_by_order[p] = squared_error(rates, window)
    authors_timing = {DEM: authors_timing_by_order[DEM_STATE_ORDER]}
    for name in (AUGMENTATION, AUTHORS_SMIKF, KALMAN):
        rates = OBSERVERS[name].estimate(window, late_outputs, window.inputs)[:, 1]
        authors_timing[name] = squared_error(rates, window)
    return WindowErrors(errors_by_delay, authors_timing, authors_timing_by_order)


def one_sample_later(values: Array) -> Array:
    """Returns values (T, channels) delayed by one sample; the first sample, which has none before it, is repeated."""
    return np.concatenate([values[:1], values[:-1]])


def squared_error(rates: Array, window: RollWindow, delay: int = 0) -> float:
    """Returns the sum of squared errors (SSE) of estimated roll rates, without ``TRIM`` samples at each end.

    Args:
        rates: (T,) estimates, rad/s.
        window: window with the measured or true roll rates, rad/s.
        delay: samples by which the estimates are delayed before they are compared.

    Returns:
        The SSE, rad²/s²; infinite if an estimate is not finite.
    """
    measured_rates = window.states[TRIM:-TRIM, 1]
    # Delayed estimates are compared with later samples, so that those used begin earlier.
    first_sample = TRIM - delay
    delayed_rates = rates[first_sample : first_sample + len(measured_rates)]
    errors = delayed_rates - measured_rates
    sse = float(errors @ errors)
    return sse if np.isfinite(sse) else np.inf


def run(runner: Runner) -> ExperimentResult:
    """Compares estimates of the hidden roll rate by DEM and by Kalman filters, by their SSE.

    On simulated windows the true roll rate is known. On the recorded flights the measured one stands for it.

    Args:
        runner: runner that has the recorded flights, if there are any, and runs the windows in several processes.

    Returns:
        Checks, tables, a figure, and all mean errors as ``numbers``.
    """
    simulated_errors = {}
    for name, smoothness in SIMULATED_SMOOTHNESS.items():
        windows = [simulated_window(seed, smoothness) for seed in range(SIMULATED_WINDOWS)]
        simulated_errors[name] = mean_errors(runner.map_jobs(window_errors, windows))
    checks = simulated_checks(simulated_errors)
    tables: tuple[Block, ...] = simulated_table(simulated_errors)
    simulated_numbers = {name: lists_by_name(errors) for name, errors in simulated_errors.items()}
    published_numbers = {name: sse._asdict() for name, sse in PUBLISHED_SSE.items()}
    numbers: JsonValues = {"simulated": simulated_numbers, "published": published_numbers}
    window_errors_by_wind = recorded_errors(runner)
    if not window_errors_by_wind:
        remark = missing_flights_sentence(runner.recorded_flights)
        return ExperimentResult(tuple(checks), numbers, tables, remarks=(remark,))
    recorded_result = _recorded_result(window_errors_by_wind)
    return ExperimentResult(
        checks=(*recorded_result.checks, *checks),
        numbers=numbers | recorded_result.numbers,
        tables=(*recorded_result.tables, *tables),
        pictures=recorded_result.pictures,
    )


def _recorded_result(window_errors_by_wind: Mapping[str, list[WindowErrors]]) -> ExperimentResult:
    """Returns checks, tables and figures of the recorded flights.

    Args:
        window_errors_by_wind: errors in the windows of the flights, as :func:`recorded_errors` returns them.

    Returns:
        Checks, numbers, tables and a figure; none of them is of simulated windows.
    """
    errors_by_delay = {}
    errors_with_published_timing = {}
    errors_of_orders = {}
    for wind, errors in window_errors_by_wind.items():
        errors_by_delay[wind] = mean_errors(errors)
        errors_with_published_timing[wind] = trimmed_errors(errors)
        errors_of_orders[wind] = errors_by_order(errors)
    # A document in JSON holds no arrays and no named tuples.
    numbers_by_delay = {}
    numbers_with_published_timing = {}
    for wind in window_errors_by_wind:
        numbers_by_delay[wind] = lists_by_name(errors_by_delay[wind])
        trimmed_means = errors_with_published_timing[wind]
        numbers_with_published_timing[wind] = {
            name: mean._asdict() for name, mean in trimmed_means.items()
        }
    return ExperimentResult(
        checks=tuple(flight_checks(errors_by_delay, errors_with_published_timing)),
        numbers={
            "recorded, by delay": numbers_by_delay,
            "recorded, authors’ timing": numbers_with_published_timing,
            "recorded, authors’ timing, DEM by order": errors_of_orders,
        },
        tables=(
            *recorded_table(errors_by_delay),
            *published_table(errors_with_published_timing),
            *order_table(errors_of_orders),
        ),
        pictures=(_delay_picture(errors_by_delay),),
    )


def recorded_errors(runner: Runner) -> dict[str, list[WindowErrors]]:
    """Returns the errors in the windows of the recorded flights, by whether they were flown in wind.

    Args:
        runner: runner that has the flights, and runs the windows.

    Returns:
        Errors by ``WITH_WIND`` and ``WITHOUT_WIND``; a group without windows is left out.
    """
    windows = flight_windows(runner.recorded_flights)
    errors = runner.map_jobs(window_errors, windows)
    errors_by_wind: dict[str, list[WindowErrors]] = {WITH_WIND: [], WITHOUT_WIND: []}
    for window, errors_of_window in zip(windows, errors, strict=True):
        errors_by_wind[wind_of_flight(window.flight)].append(errors_of_window)
    return {wind: wind_errors for wind, wind_errors in errors_by_wind.items() if wind_errors}


def mean_errors(errors: Sequence[WindowErrors]) -> dict[str, Array]:
    """Returns the mean squared error of each observer, by the number of samples that its estimates are delayed.

    Args:
        errors: errors of all observers in each window.

    Returns:
        By name of the observer, (MAX_DELAY + 1,) mean SSE over the windows, one for each delay from 0.
    """
    means = {}
    for name in OBSERVERS:
        sse = np.array([window.by_delay[name] for window in errors])
        means[name] = sse.mean(axis=0)
    return means


class TrimmedMean(NamedTuple):
    """Mean SSE of one observer over windows, by the authors' criterion; the fields are keys of documents."""

    sse: float
    """Mean over the windows with an SSE below ``OUTLIER_SSE``, (rad/s)²; NaN without any."""

    windows_left_out: int
    """Number of windows with a larger SSE."""


def trimmed_errors(errors: Sequence[WindowErrors]) -> dict[str, TrimmedMean]:
    """Returns the mean error (SSE) of each published observer with the authors' timing, without outliers as they did.

    Args:
        errors: errors in each window.

    Returns:
        Mean SSE over the windows below ``OUTLIER_SSE``, and the number of other windows, by observer.
    """
    means = {}
    for name in PUBLISHED_SSE:
        sse = np.array([window.authors_timing[name] for window in errors])
        sse_below_limit = sse[sse < OUTLIER_SSE]
        mean = float(sse_below_limit.mean()) if len(sse_below_limit) else np.nan
        means[name] = TrimmedMean(mean, len(sse) - len(sse_below_limit))
    return means


def errors_by_order(errors: Sequence[WindowErrors]) -> dict[str, float]:
    """Returns DEM's mean SSE over windows, with the authors' timing, by embedding order such as ``p = 2``."""
    means = {}
    for p in PUBLISHED_SSE_BY_ORDER:
        means[f"p = {p}"] = float(np.mean([window.authors_timing_by_order[p] for window in errors]))
    return means


def flight_checks(
    errors_by_delay: Mapping[str, Mapping[str, Array]],
    errors_with_published_timing: Mapping[str, Mapping[str, TrimmedMean]],
) -> list[Check]:
    """Checks that DEM has the least error of the observers on the recorded flights in wind.

    DEM's estimate at a sample uses some later samples as well, which Kalman filters do not. So it is compared four
    times: with the filters of Bos et al. at the timing of their scripts; with these filters at each sample's own time;
    with fixed-lag smoothers, which use as many later samples as DEM; and with a derivative of the measured roll, which
    needs no model.

    Args:
        errors_by_delay: mean SSE by wind and observer, for each number of samples by which estimates are delayed
            (``MAX_DELAY`` + 1,).
        errors_with_published_timing: mean SSE by wind and observer, with the timing and without the outliers of the
            authors.

    Returns:
        The four checks; none without flights in wind.
    """
    if WITH_WIND not in errors_by_delay:
        return []
    errors_in_wind = {
        name: mean.sse for name, mean in errors_with_published_timing[WITH_WIND].items()
    }
    published_observers = (KALMAN, AUTHORS_SMIKF, AUGMENTATION)
    # Delay 0: each estimate is compared with the roll rate at its own time.
    undelayed_errors = {name: errors[0] for name, errors in errors_by_delay[WITH_WIND].items()}
    return [
        least_error_check(
            errors_in_wind, published_observers, "flights in wind, the authors’ timing"
        ),
        least_error_check(undelayed_errors, PEERS, "flights in wind, own time"),
        least_error_check(
            undelayed_errors, FIXED_LAG_SMOOTHERS, "flights in wind, equal look-ahead"
        ),
        least_error_check(undelayed_errors, (DERIVATIVE,), "flights in wind, without a model"),
    ]


def simulated_checks(simulated_errors: Mapping[str, Mapping[str, Array]]) -> list[Check]:
    """Checks that DEM has the least error of the observers on simulated windows with coloured noise.

    Args:
        simulated_errors: (delays,) mean SSE, by name of the noise and observer.

    Returns:
        Two checks for each coloured noise: with each observer's own timing, and with equal look-ahead.
    """
    checks = []
    for name, smoothness in SIMULATED_SMOOTHNESS.items():
        # Noise of the smoothness 0 is white.
        if smoothness == 0:
            continue
        undelayed_errors = {}
        for observer, errors_by_delay in simulated_errors[name].items():
            # Delay 0: each estimate is compared with the roll rate at its own time.
            undelayed_errors[observer] = errors_by_delay[0]
        data = f"simulated, {name}"
        checks.append(least_error_check(undelayed_errors, PEERS, data))
        checks.append(
            least_error_check(undelayed_errors, FIXED_LAG_SMOOTHERS, f"{data}, equal look-ahead")
        )
    return checks


def least_error_check(errors: Mapping[str, float], peers: Sequence[str], data: str) -> Check:
    """Checks that DEM has a lower mean SSE than each of its peers.

    Args:
        errors: mean SSE by observer, rad²/s².
        peers: names of the observers that DEM is compared with.
        data: name of the data, for the text.

    Returns:
        The check, with the errors of DEM and of the best peer.
    """
    best_peer = min(peers, key=lambda name: errors[name])
    return Check(
        rule=f"{data}: the mean SSE of {DEM} is lower than that of {listed(peers)}",
        holds=errors[DEM] < errors[best_peer],
        finding=f"{data}: {DEM} has an SSE of {rounded(errors[DEM], 3)}, {best_peer} of "
        f"{rounded(errors[best_peer], 3)}",
    )


def published_table(
    errors_with_published_timing: Mapping[str, Mapping[str, TrimmedMean]],
) -> tuple[Block, ...]:
    """Returns the table that compares our errors with the published ones, observer by observer.

    Ours are computed with the authors' timing. The observer with the least error in the first wind comes first.

    Args:
        errors_with_published_timing: mean SSE, (rad/s)², by wind and observer.

    Returns:
        A sentence and the table.
    """
    winds = list(errors_with_published_timing)
    errors_in_first_wind = errors_with_published_timing[winds[0]]
    header = ["observer"]
    for wind in winds:
        header += [f"{wind}, SSE", "published", "windows left out"]
    rows = []
    for observer in sorted(PUBLISHED_SSE, key=lambda name: errors_in_first_wind[name].sse):
        row = [observer]
        for wind in winds:
            mean = errors_with_published_timing[wind][observer]
            published_sse = PUBLISHED_SSE[observer].without_wind
            if wind == WITH_WIND:
                published_sse = PUBLISHED_SSE[observer].with_wind
            row += [rounded(mean.sse, 3), rounded(published_sse, 3), str(mean.windows_left_out)]
        rows.append(row)
    introduction = Sentence(
        "mean SSE of the hidden roll rate in windows of 2 s, (rad/s)². Published are the means of experiments 21, "
        "22, 24 and 25, read from the authors’ figure.",
        "The authors’ scripts, with their timing:",
    )
    return introduction, Table(header, rows)


def order_table(errors_of_orders: Mapping[str, Mapping[str, float]]) -> tuple[Block, ...]:
    """Returns the table of DEM's errors by wind and embedding order, with the published ones of flights in wind.

    Args:
        errors_of_orders: mean SSE by wind and embedding order.

    Returns:
        A sentence and the table.
    """
    orders = [f"p = {p}" for p in PUBLISHED_SSE_BY_ORDER]
    rows = []
    for wind, errors in errors_of_orders.items():
        cells = [rounded(errors[order], 3) for order in orders]
        rows.append([wind, *cells])
    published_cells = [rounded(sse, 3) for sse in PUBLISHED_SSE_BY_ORDER.values()]
    rows.append(["with wind, published", *published_cells])
    return (
        Sentence("mean SSE, (rad/s)², with the authors’ timing.", "DEM by embedding order:"),
        Table(["flights", *orders], rows),
    )


def recorded_table(errors_by_delay: Mapping[str, Mapping[str, Array]]) -> tuple[Block, ...]:
    """Returns the table of the observers' errors without a delay and at the best delay, the least error first.

    An estimate may fit the measured roll rate best if it is compared with a later sample: a delay of that many samples.

    Args:
        errors_by_delay: mean sum of squared errors (SSE) for delays of 0, 1, … samples (delays,), by wind and observer.

    Returns:
        A sentence and the table.
    """
    winds = list(errors_by_delay)
    errors_in_first_wind = errors_by_delay[winds[0]]
    header = ["observer", "look-ahead, samples"]
    for wind in winds:
        header += [f"{wind}, SSE", "at the best delay", "delay, samples"]
    rows = []
    late_count = 0
    # The observer with the least error without a delay comes first.
    for name in sorted(COMPARED_OBSERVERS, key=lambda name: errors_in_first_wind[name][0]):
        row = [name, str(OBSERVERS[name].look_ahead)]
        for wind in winds:
            errors = errors_by_delay[wind][name]
            best_delay = int(errors.argmin())
            row += [rounded(errors[0], 3), rounded(errors[best_delay], 3), str(best_delay)]
        if errors_in_first_wind[name].argmin() > 0:
            late_count += 1
        rows.append(row)
    return (
        Sentence(
            f"each sample’s own output is used. {winds[0].capitalize()}, {late_count} of {len(rows)} observers fit "
            "best when their estimates are delayed: the measured roll rate lags the derivative of the measured roll, "
            "so part of each error is the reference’s.",
            "At the estimates’ own time:",
        ),
        Table(header, rows),
    )


def simulated_table(simulated_errors: Mapping[str, Mapping[str, Array]]) -> tuple[Block, ...]:
    """Returns the table of the errors on simulated windows, the least error with the smoothest noise first.

    Args:
        simulated_errors: (delays,) mean SSE, by name of the noise and observer.

    Returns:
        A sentence and the table.
    """
    noises = list(simulated_errors)
    errors_in_smoothest_noise = simulated_errors[noises[-1]]
    # The table shows estimates that are not delayed, whose error is the first one.
    observers = sorted(COMPARED_OBSERVERS, key=lambda name: errors_in_smoothest_noise[name][0])
    rows = []
    for observer in observers:
        row = [observer, str(OBSERVERS[observer].look_ahead)]
        for noise in noises:
            row.append(rounded(simulated_errors[noise][observer][0], 3))
        rows.append(row)
    return (
        Sentence(
            f"mean SSE against the true roll rate over {SIMULATED_WINDOWS} windows, (rad/s)². The model is exact, and "
            "s is the width of the process noise’s kernel.",
            "Simulated:",
        ),
        Table(["observer", "look-ahead, samples", *noises], rows),
    )


def _delay_picture(errors_by_delay: Mapping[str, Mapping[str, Array]]) -> Picture:
    """Returns the figure of the errors on the flights by the delay of the estimates.

    Args:
        errors_by_delay: (delays,) mean SSE, by wind and observer.

    Returns:
        The picture, with a panel for each wind and a line for each of ``COMPARED_OBSERVERS``.
    """
    panels = {}
    for wind, errors in errors_by_delay.items():
        panels[wind] = {name: errors[name] for name in COMPARED_OBSERVERS}
    return Picture(
        "Error of the hidden roll rate by the delay of the estimates",
        "Mean SSE over the windows of the flights, (rad/s)².",
        partial(figures.draw_lines, panels, "delay, samples", scale="log"),
    )
