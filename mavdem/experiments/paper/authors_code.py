"""Results of the authors' own MATLAB code on a simulated System 2, compared with ours on the same data."""

from functools import partial
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import CONFIDENCE_LEVEL, INTERVAL_QUANTILES
from mavdem.experiments import methods
from mavdem.experiments.compared_methods import Method
from mavdem.experiments.paper.checks import Check, ExperimentResult, lists_by_name, percent
from mavdem.experiments.paper.flights import DATA_FOLDER, TRAINING_SAMPLES
from mavdem.experiments.paper.runner import (
    DATA_START,
    FORECAST_KIND_BY_START,
    PAPER_SETTINGS,
    PAPER_SETTINGS_P1,
    ZERO_START,
    Runner,
    forecast_errors,
    random_prior_methods,
)
from mavdem.experiments.window import Window
from mavdem.flight import Flight
from mavdem.report.numbers import rounded

RESULTS_FOLDER = DATA_FOLDER / "oracle"
"""Folder of the data and results of the authors' code, NumPy files; not part of the package."""

TRUE_MODEL_MSPE = 0.0033
"""MSPE of the forecast by the model that simulated the data, from the data."""

DEM_P2 = "DEM p=2"
DEM_P1 = "DEM p=1"
EM = "EM"
METHODS = (DEM_P2, DEM_P1, EM)
"""Names of the methods that both the authors' code and ours have."""

MIN_RELATIVE_RANGE = 1e-3
"""Errors whose range is below this fraction of the largest are reported as one number; a choice."""


class MspeKeys(NamedTuple):
    """Keys of the errors in the authors' files, for one start of the forecasts."""

    dem: str
    """Key in the results of DEM."""

    em: str
    """Key in the results of EM."""


AUTHORS_MSPE_KEYS = {
    DATA_START: MspeKeys(dem="mspe_x0last", em="mspe_x0last_aligned"),
    ZERO_START: MspeKeys(dem="mspe_x0zero", em="mspe_x0zero"),
}
"""Keys of the MSPE by start of the forecasts."""


def run(runner: Runner) -> ExperimentResult:
    """Checks that our DEM and EM have the same forecast errors as the authors' MATLAB code on the same data.

    The authors' code draws the prior of DEM's parameters at random, and its result depends on it. Ours is fitted from
    many random priors, and a check tests whether the authors' error lies within the range of ours.

    Args:
        runner: runner of the fits, which also states whether recorded data are used.

    Returns:
        A check for each method and start of the forecasts, and the MSPE of both codes as ``numbers``. Without the
        authors' files only a remark.
    """
    if not runner.uses_authors_results or not RESULTS_FOLDER.is_dir():
        missing_text = f"The authors’ results are not in {RESULTS_FOLDER}, so there is nothing to compare with."
        return ExperimentResult(remarks=(missing_text,))
    authors_errors = read_authors_errors()
    our_errors = _our_errors(runner)
    checks = []
    for method in METHODS:
        for start in FORECAST_KIND_BY_START:
            checks.append(
                agreement_check(
                    method, start, our_errors[start][method], authors_errors[start][method]
                )
            )
    return ExperimentResult(
        checks=tuple(checks),
        numbers={
            "theirs": {start: lists_by_name(errors) for start, errors in authors_errors.items()},
            "ours": {start: lists_by_name(errors) for start, errors in our_errors.items()},
            "true_model_from_data": TRUE_MODEL_MSPE,
        },
        remarks=(
            f"The forecast of the true model, from the data, has an MSPE of {TRUE_MODEL_MSPE}. The authors’ DEM "
            "result is of one random prior; its forecast from state 0 starts one sample late. Their EM learns a "
            "feedthrough term and leaves it out of the forecast.",
        ),
    )


def _our_errors(runner: Runner) -> dict[str, dict[str, Array]]:
    """Trains this project's DEM and EM on the data that the paper's authors published, and returns their errors.

    They are compared with the errors of the authors' code on the same data. DEM depends on the random prior of its
    parameters, so it is trained from many. EM is deterministic and is trained once.

    Args:
        runner: runs the fits, and has the number of random priors.

    Returns:
        MSPE by start of the forecasts and by method: (priors,) for DEM, from as many random priors, and (1,) for EM.
    """
    window = read_authors_window()
    methods_by_name = {
        DEM_P2: random_prior_methods(PAPER_SETTINGS, runner.prior_count),
        DEM_P1: random_prior_methods(PAPER_SETTINGS_P1, runner.prior_count),
        EM: [Method(EM, partial(methods.em, order=2))],
    }
    trials = {}
    for name, methods_of_name in methods_by_name.items():
        trials[name] = [(method, window) for method in methods_of_name]
    outcomes = runner.run_trials(trials)
    errors = {}
    for start in FORECAST_KIND_BY_START:
        errors[start] = {name: forecast_errors(outcomes[name], start) for name in METHODS}
    return errors


def agreement_check(method: str, start: str, ours: Array, theirs: Array) -> Check:
    """Checks that the errors of our method agree with the errors of the authors' code.

    The authors' DEM result, of one random prior, must lie in the central 90 % of ours over random priors. Of EM we have
    one fit and they have five, so the median of ours must lie between the best and the worst of theirs.

    Args:
        method: name of the method, one of ``METHODS``.
        start: start of the forecasts, for the text.
        ours: (N,) mean squared prediction errors (MSPE) of our fits.
        theirs: (M,) mean squared prediction errors of the authors' fits.

    Returns:
        The check, with the figures that it compares.
    """
    our_median = np.median(ours)
    if method == EM:
        return Check(
            rule=f"{method}, from {start}: the median of ours lies between the best and the worst of theirs",
            holds=bool(theirs.min() <= our_median <= theirs.max()),
            finding=f"{method} from {start}: our MSPE is {_range_text(ours)}, theirs {_range_text(theirs)}",
        )
    # The authors' DEM has a single result. Its quantile among ours is the fraction of our errors below it.
    their_error = theirs[0]
    quantile = float((ours < their_error).mean())
    lowest_quantile, highest_quantile = INTERVAL_QUANTILES
    return Check(
        rule=f"{method}, from {start}: theirs lies in the central {percent(CONFIDENCE_LEVEL)} of ours over random "
        "priors",
        holds=lowest_quantile <= quantile <= highest_quantile,
        finding=f"{method} from {start}: their MSPE is {rounded(their_error, 3)}, above {percent(quantile)} of ours "
        f"(median {rounded(float(our_median), 3)})",
    )


def _range_text(errors: Array) -> str:
    """Returns the lowest, highest and median of errors (N,) as text, or the median alone if all are nearly equal."""
    median = rounded(float(np.median(errors)), 3)
    if np.ptp(errors) < MIN_RELATIVE_RANGE * abs(errors).max():
        return median
    return f"{rounded(errors.min(), 3)} to {rounded(errors.max(), 3)} (median {median})"


def read_authors_window() -> Window:
    """Reads the authors' simulated data of System 2 (their case c2) as a window of 700 training and 150 test samples.

    Their inputs, motor pulse widths, are stored as (r, T), their outputs as (T, m). The sampling step is in s.

    Returns:
        The window, with inputs (T, r) and outputs (T, m).
    """
    data = _load_arrays("case_c2_data_p2")
    dt = data["dt"].item()
    time = dt * np.arange(len(data["y_full"]))
    flight = Flight(time, data["pwm"].T, data["y_full"])
    return Window(
        "System 2, simulated by the authors’ recipe",
        0,
        flight[:TRAINING_SAMPLES],
        flight[TRAINING_SAMPLES:],
    )


def read_authors_errors() -> dict[str, dict[str, Array]]:
    """Reads the forecast errors (MSPE) that the authors' code has on their data.

    Returns:
        By start of the forecasts and by method, arrays of errors: (1,) for DEM with one random prior, (5,) for EM.
    """
    em_results = _load_arrays("case_c2_em")
    dem_p2_results = _load_arrays("case_c2_octave_p2")
    dem_p1_results = _load_arrays("case_c2_octave_p1")
    errors = {}
    for start, keys in AUTHORS_MSPE_KEYS.items():
        errors[start] = {
            DEM_P2: dem_p2_results[keys.dem].ravel(),
            DEM_P1: dem_p1_results[keys.dem].ravel(),
            EM: em_results[keys.em].ravel(),
        }
    return errors


def _load_arrays(stem: str) -> dict[str, Array]:
    """Loads all arrays of a NumPy file of ``RESULTS_FOLDER``, by name."""
    with np.load(RESULTS_FOLDER / f"{stem}.npz") as arrays:
        return dict(arrays)
