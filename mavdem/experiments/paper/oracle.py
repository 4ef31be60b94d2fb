"""The authors' own code on a simulated System 2, and ours on the same data."""

from functools import partial

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import CONFIDENCE_LEVEL, INTERVAL_QUANTILES
from mavdem.experiments import methods
from mavdem.experiments.comparison import Method
from mavdem.experiments.paper.runner import (
    PAPER,
    PAPER_P1,
    SHARED,
    STARTS,
    TRAIN,
    Check,
    ExperimentResult,
    Runner,
    errors_of,
    percent,
    plain,
)
from mavdem.experiments.window import Window
from mavdem.flight import Flight
from mavdem.report.numbers import rounded

FOLDER = SHARED / "oracle"
TRUE_MODEL = 0.0033  # MSPE of the true model's forecast, from the data
METHODS = ("DEM p=2", "DEM p=1", "EM")


def run(runner: Runner) -> ExperimentResult:
    """Fits the authors' data with our DEM and EM, from several priors."""
    if not runner.uses_recorded or not FOLDER.is_dir():
        return ExperimentResult(
            remarks=(
                f"The authors’ results are not in {FOLDER}, so there is nothing to compare with.",
            )
        )
    window = authors_window()
    theirs = authors_errors()
    fits = {"DEM p=2": runner.priors(PAPER), "DEM p=1": runner.priors(PAPER_P1)}
    fits["EM"] = [Method("EM", partial(methods.em, order=2))]
    trials = runner.try_all({name: [(fit, window) for fit in own] for name, own in fits.items()})
    ours = {start: {name: errors_of(trials[name], start) for name in METHODS} for start in STARTS}
    return ExperimentResult(
        checks=tuple(
            check(name, start, ours[start][name], theirs[start][name])
            for name in METHODS
            for start in STARTS
        ),
        numbers={
            "theirs": {start: plain(errors) for start, errors in theirs.items()},
            "ours": {start: plain(errors) for start, errors in ours.items()},
            "true_model_from_data": TRUE_MODEL,
        },
        remarks=(
            f"The forecast of the true model, from the data, has an MSPE of {TRUE_MODEL}. The authors’ DEM result is "
            "of one random prior; its forecast from state 0 starts one sample late. Their EM learns a feedthrough term "
            "and leaves it out of the forecast.",
        ),
    )


def check(name: str, start: str, ours: Array, theirs: Array) -> Check:
    """Returns whether the authors' DEM, of one random prior, lies in the central part of ours; for EM, the reverse."""
    if name == "EM":
        return Check(
            f"{name}, from {start}: the median of ours lies between the best and the worst of theirs",
            bool(theirs.min() <= np.median(ours) <= theirs.max()),
            f"{name} from {start}: our MSPE is {_range(ours)}, theirs {_range(theirs)}",
        )
    below = float((ours < theirs[0]).mean())
    return Check(
        f"{name}, from {start}: theirs lies in the central {percent(CONFIDENCE_LEVEL)} of ours over random priors",
        INTERVAL_QUANTILES[0] <= below <= INTERVAL_QUANTILES[1],
        f"{name} from {start}: their MSPE is {rounded(theirs[0], 3)}, above {percent(below)} of ours (median "
        f"{rounded(float(np.median(ours)), 3)})",
    )


def _range(values: Array) -> str:
    middle = rounded(float(np.median(values)), 3)
    if np.ptp(values) < 1e-3 * abs(values).max():
        return middle
    return f"{rounded(values.min(), 3)} to {rounded(values.max(), 3)} (median {middle})"


def authors_window() -> Window:
    """Returns the data of case c2: 700 training and 150 test samples."""
    data = _load("case_c2_data_p2")
    dt = data["dt"].item()
    flight = Flight(dt * np.arange(len(data["y_full"])), data["pwm"].T, data["y_full"])
    return Window("System 2, simulated by the authors’ recipe", 0, flight[:TRAIN], flight[TRAIN:])


def authors_errors() -> dict[str, dict[str, Array]]:
    """Returns the MSPE of the authors' code, by start and method."""
    em, with_, without = (_load(f"case_c2_{name}") for name in ("em", "octave_p2", "octave_p1"))
    keys = {
        "the data": ("mspe_x0last", "mspe_x0last_aligned"),
        "state 0": ("mspe_x0zero", "mspe_x0zero"),
    }
    return {
        start: {
            "DEM p=2": with_[dem].ravel(),
            "DEM p=1": without[dem].ravel(),
            "EM": em[em_key].ravel(),
        }
        for start, (dem, em_key) in keys.items()
    }


def _load(name: str) -> dict[str, Array]:
    with np.load(FOLDER / f"{name}.npz") as saved:
        return dict(saved)
