"""Comparison: every method on every window of every flight, the first method beside each of the others.

The error ratio of a window is that of the whole test part: its error over that of the constant mean. A flight has the
median over its windows, because a mean would show one diverged forecast only, and the worst window beside it. Over
flights it is the geometric mean of these medians, so that each flight counts once.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from operator import itemgetter
from time import thread_time
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import JsonValues, Names
from mavdem.dem import Settings, learn
from mavdem.dem.parallel import parallel_map
from mavdem.errors import fact_from_error
from mavdem.experiments import methods
from mavdem.experiments.held_out import Progress
from mavdem.experiments.paired_test import FEWEST_PAIRS, Paired, paired
from mavdem.experiments.scores import (
    FROM_ZERO,
    KNOWN,
    UNKNOWN,
    Question,
    Scores,
    horizons,
    mspe,
    units_of,
)
from mavdem.experiments.window import Window
from mavdem.facts import Fact
from mavdem.facts.forecasts import HeldOutForecast, MethodName
from mavdem.flight import Flight
from mavdem.forecaster import Forecaster, ProbabilisticForecaster

# numbers of windows, summed over flights
COUNTS = ("windows", "failed", "diverged", "unstable", "worse_than_constant")


class Method(NamedTuple):
    """A method to compare, of a unique ``name``: ``learn`` trains a model on a flight, and pickles.

    With ``predicts`` its model is also asked what comes next, the inputs unknown.
    """

    name: str
    learn: Callable[[Flight], Forecaster]
    predicts: bool = False


PLANT = Settings(forecasts="plant")
DEM = {
    MethodName.JOINT: Settings(),
    MethodName.PLANT: PLANT,
    MethodName.PLANT_P1: replace(PLANT, p=1, d=1),
    MethodName.PAPER: Settings.paper(),
    MethodName.PAPER_P1: replace(Settings.paper(), p=1, d=1, window=2),
}
PEERS = (
    *(Method(f"subspace({order})", partial(methods.subspace, order=order)) for order in (2, 4)),
    *(Method(f"PEM({order})", partial(methods.pem, order=order)) for order in (2, 4)),
    Method("EM(2)", partial(methods.em, order=2)),
    *(
        Method(f"{MethodName.JOINT_VAR}({order})", partial(methods.var, order=order), predicts=True)
        for order in (4, 10)
    ),
)
METHODS = (
    *(
        Method(name, partial(learn, settings=settings), predicts=name is MethodName.JOINT)
        for name, settings in DEM.items()
    ),
    *PEERS,
    Method(HeldOutForecast.CONSTANT_MEAN, methods.constant_mean, predicts=True),
    Method(HeldOutForecast.HOLD_LAST, methods.hold, predicts=True),
    Method("zero", methods.zero),
)
"""The methods of ``mavdem compare``; the first is compared with each of the others. "DEM joint" is the joint model of
outputs and motors, "DEM plant" DEM's model with the motors as causes, both by the default settings. p = 1 is what the
paper calls without generalized coordinates (section V.G): the first derivative only, which the model itself needs."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """One method on one window; every error is infinite if it has no forecast.

    ``failure`` says why; ``stable`` is ``None`` without a model; ``seconds`` are processor time of the training;
    ``scores`` and ``forecasts``, (H, m), are by question.
    """

    method: str
    flight: str
    start: int
    failure: Fact | None
    stable: bool | None
    cautions: tuple[Fact | str, ...]
    seconds: float
    scores: Mapping[Question, Scores]
    forecasts: Mapping[Question, Array]

    def mspe(self, question: Question = KNOWN) -> Array:
        """Returns the MSPE (m,) over the whole test part, in the squares of the outputs' units, of a ``question``."""
        return self.scores[question].squared_error[-1]

    def to_dict(self, question: Question = KNOWN) -> JsonValues:
        """Returns values of a ``question`` for its document, without the forecasts themselves."""
        errors = self.mspe(question)
        scores = self.scores[question]
        return {
            "failure": self.failure,
            "stable": self.stable,
            "cautions": self.cautions,
            "mspe": {"per_output": errors, "total": errors.sum()},
            "relative": scores.ratio,
            "inside_90_percent_band": [_mean([share]) for share in scores.inside.tolist()],
            "seconds": round(self.seconds, 4),
        }


def evaluate_window(method: Method, window: Window) -> Outcome:
    """Trains ``method`` on the first part of ``window`` and forecasts the second; failures are in the outcome."""
    began = thread_time()
    outcome = partial(Outcome, method.name, window.flight, window.start)
    # The outcome has what numpy and scipy would warn of.
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            model = method.learn(window.train)
            seconds = thread_time() - began
            scores, forecasts = _scored(method, window, model)
            return outcome(None, model.stable, model.cautions, seconds, scores, forecasts)
        except (ValueError, ArithmeticError, RuntimeError) as error:
            failure = fact_from_error(error)
    return outcome(failure, None, (), thread_time() - began, _without_forecast(method, window), {})


def _without_forecast(method: Method, window: Window) -> dict[Question, Scores]:
    """Scores of a method that has none: its errors are infinite."""
    test = window.test
    (variance, baseline) = np.ones((2, test.outputs.shape[1]))
    scores = {}
    for question in (KNOWN, FROM_ZERO, *[UNKNOWN] * method.predicts):
        steps = _steps(question, test)
        errors = np.full((len(steps), len(variance)), np.inf)
        scores[question] = Scores(steps, errors, errors[:, 0] * np.nan, variance, baseline)
    return scores


def _steps(question: Question, test: Flight) -> tuple[int, ...]:
    return (len(test),) if question == FROM_ZERO else horizons(len(test), test.dt)


def _scored(
    method: Method, window: Window, model: Forecaster
) -> tuple[dict[Question, Scores], dict[Question, Array]]:
    """The scores of a model, and its forecasts (H, m) of the whole test part by question."""
    test = window.test
    forecasts = {
        KNOWN: model.forecast(test.inputs),
        FROM_ZERO: model.forecast(test.inputs, from_zero=True),
    }
    bands = {}
    if method.predicts:
        forecasts[UNKNOWN] = model.predict(len(test))
    if isinstance(model, ProbabilisticForecaster):
        bands[KNOWN] = model.forecast_band(test.inputs)
        if method.predicts:
            bands[UNKNOWN] = model.predict_band(len(test))
    units = units_of(window.train, test)
    scores = {}
    for question, whole in forecasts.items():
        steps = _steps(question, test)
        again = model.predict_every if question == UNKNOWN else model.forecast_every
        pieces = [again(number, test.inputs, test.outputs) for number in steps[:-1]]
        errors = np.array([mspe(test.outputs, made).per_output for made in (*pieces, whole)])
        inside = np.full(len(steps), np.nan)
        if question in bands:
            held = abs(test.outputs - whole) <= bands[question]
            inside = np.array([held[:number].mean() for number in steps])
        scores[question] = Scores(steps, errors, inside, *units)
    return scores, forecasts


def compare(
    windows: Sequence[Window],
    methods: Sequence[Method] = METHODS,
    progress: Progress = lambda _: None,
) -> Comparison:
    """Runs all ``methods`` on all ``windows`` and compares the first with each of the others.

    It uses all cores of this process, in processes that import the running script: call it below ``if __name__ ==
    "__main__":``. ``progress`` is called with the share done.

    Raises:
        ValueError: there is no window.
        concurrent.futures.BrokenExecutor: a worker died, for example for lack of memory.
    """
    if not windows:
        raise ValueError("windows must be one at least")
    made = []
    trials = [(method, window) for window in windows for method in methods]
    with closing(parallel_map(run_trial, trials)) as coming:
        for outcome in coming:
            made.append(outcome)
            progress(len(made) / len(trials))
    rows = (tuple(made[at : at + len(methods)]) for at in range(0, len(trials), len(methods)))
    return Comparison(tuple(windows), tuple(method.name for method in methods), tuple(rows))


def run_trial(trial: tuple[Method, Window]) -> Outcome:
    """Trains a method on a window and forecasts its test part; a method that fails has infinite errors."""
    return evaluate_window(*trial)


@dataclass(frozen=True, eq=False)
class Comparison:
    """All ``outcomes``, by window and in each by method, and their summaries.

    The first of the ``methods``, which are names, is compared with each of the others. ``windows`` of a flight have the
    same number of samples.
    """

    windows: tuple[Window, ...]
    methods: Names
    outcomes: tuple[tuple[Outcome, ...], ...]

    @cached_property
    def flights(self) -> Names:
        """Their names, in order of appearance."""
        return tuple(dict.fromkeys(window.flight for window in self.windows))

    def methods_of(self, question: Question) -> Names:
        """Returns the names of the methods that answer a ``question``."""
        return tuple(outcome.method for outcome in self.outcomes[0] if question in outcome.scores)

    def of_flight(self, flight: str) -> Comparison:
        """Returns the part of one ``flight``, by its name."""
        own = [number for number, window in enumerate(self.windows) if window.flight == flight]
        windows = tuple(self.windows[number] for number in own)
        return Comparison(windows, self.methods, tuple(self.outcomes[number] for number in own))

    def summaries(self, flight: str, question: Question = KNOWN) -> tuple[JsonValues, ...]:
        """Returns each method's summary of a ``question`` on the ``flight`` of that name, the lowest error first.

        ``windows`` and the ``COUNTS`` are numbers of windows; ``failure`` is the first reason; ``mspe`` per output and
        ``mspe_total`` are means over windows, as the paper has them; ``relative`` and ``worst`` the median and the
        largest error ratio. Of each of the ``horizons``, the last that of the whole test part, there are the median,
        ``inside``, the mean share in the 90 % band or None, and ``reference``, the first method beside this one
        (:class:`mavdem.evaluate.Paired`).
        """
        return self._summaries[flight, question]

    @cached_property
    def _columns(self) -> dict[str, tuple[Outcome, ...]]:
        return dict(zip(self.methods, zip(*self.outcomes, strict=True), strict=True))

    @cached_property
    def _summaries(self) -> dict[tuple[str, Question], tuple[JsonValues, ...]]:
        return {
            (flight, question): self.of_flight(flight)._standings(question)
            for flight, question in product(self.flights, Question)
        }

    def _standings(self, question: Question) -> tuple[JsonValues, ...]:
        """Of one flight."""
        methods = self.methods_of(question)
        rows = [self._summary(method, question, methods[0]) for method in methods]
        return tuple(sorted(rows, key=itemgetter("relative")))

    def _summary(self, method: str, question: Question, reference: str) -> JsonValues:
        mine = self._columns[method]
        scores = [outcome.scores[question] for outcome in mine]
        ratios = np.array([each.ratio for each in scores])
        whole = ratios[:, -1]
        others = self._columns[reference]
        reference_ratios = np.array([outcome.scores[question].ratio for outcome in others])
        squares = np.array([each.squared_error for each in scores])
        inside = np.array([each.inside for each in scores])
        errors = squares[:, -1].mean(axis=0)
        return {
            "method": method,
            "windows": len(mine),
            "failed": sum(outcome.failure is not None for outcome in mine),
            "failure": next((outcome.failure for outcome in mine if outcome.failure), None),
            "diverged": sum(
                outcome.failure is None and not np.isfinite(outcome.mspe(question)).all()
                for outcome in mine
            ),
            "unstable": sum(outcome.stable is False for outcome in mine),
            "mspe": errors.tolist(),
            "mspe_total": errors.sum(),
            "relative": np.median(whole),
            "worst": whole.max(),
            "worse_than_constant": int((whole > 1).sum()),
            "horizons": [
                {
                    "steps": steps,
                    "relative": np.median(ratios[:, row]),
                    "reference": paired(reference_ratios[:, row], ratios[:, row], self.windows),
                    "inside": _mean(inside[:, row].tolist()),
                }
                for row, steps in enumerate(scores[0].steps)
            ],
            "seconds": np.median([outcome.seconds for outcome in mine]),
        }

    def tests(self, question: Question = KNOWN) -> dict[str, Paired]:
        """Returns the first method beside each other one over the whole test part, by name, for a ``question``.

        Pairs are flights where there are enough of them to distinguish anything, and else windows of all flights.
        """
        first, *others = self.methods_of(question)
        if len(self.flights) >= FEWEST_PAIRS:
            tests = {row["method"]: row["reference"] for row in self.over_flights(question)}
            return {name: tests[name] for name in tests if name != first}
        whole = {
            name: [outcome.scores[question].ratio[-1] for outcome in self._columns[name]]
            for name in (first, *others)
        }
        return {name: paired(whole[first], whole[name], self.windows) for name in others}

    def over_flights(self, question: Question = KNOWN) -> tuple[JsonValues, ...]:
        """Returns each method's summary of a ``question`` over all flights, the lowest error first.

        ``relative`` and ``horizons``, those that all have, are geometric means of the flights' medians, ``inside`` is a
        mean, ``COUNTS`` and ``mspe_total`` are sums; of ``reference`` each flight is one pair.
        """
        summaries = [row for flight in self.flights for row in self.summaries(flight, question)]
        overall = []
        for method in self.methods_of(question):
            rows = [row for row in summaries if row["method"] == method]
            shared = min(len(row["horizons"]) for row in rows)
            # The last is the whole test part, on whatever number of horizons before it.
            columns = [[row["horizons"][i] for row in rows] for i in (*range(shared - 1), -1)]
            ratios = [row["horizons"][-1]["reference"].ratio for row in rows]
            overall.append(
                {
                    "method": method,
                    "flights": len(rows),
                    "relative": _geometric([row["relative"] for row in rows]),
                    "horizons": [
                        _geometric([at["relative"] for at in column]) for column in columns
                    ],
                    "inside": [_mean(at["inside"] for at in column) for column in columns],
                    **{name: sum(row[name] for row in rows) for name in COUNTS},
                    "mspe_total": np.sum([row["mspe_total"] for row in rows]),
                    "reference": paired(ratios, np.ones(len(ratios))),
                }
            )
        return tuple(sorted(overall, key=itemgetter("relative")))

    def to_dict(self, question: Question = KNOWN) -> JsonValues:
        """Returns values of a ``question`` for its document, by flight and by window, infinite errors as infinity.

        Of forecasts given the inputs, the same of predictions without them is in ``predictions``.
        """
        predicted = question != UNKNOWN and self.methods_of(UNKNOWN)
        return {
            "reference": self.methods_of(question)[0],
            "methods": self.methods_of(question),
            "start": "zero" if question == FROM_ZERO else "data",
            "verdicts": self.tests(question),
            "over_flights": self.over_flights(question),
            "flights": [self._flight(flight, question) for flight in self.flights],
            "predictions": self.to_dict(UNKNOWN) if predicted else None,
        }

    def _flight(self, flight: str, question: Question) -> JsonValues:
        part = self.of_flight(flight)
        train = part.windows[0].train
        test = part.windows[0].test
        kept = set(self.methods_of(question))
        return {
            "flight": flight,
            "dt": train.dt,
            "outputs": train.output_names,
            "output_units": train.output_units,
            "training_samples": len(train),
            "forecast_samples": len(test),
            "standings": self.summaries(flight, question),
            "windows": [
                {
                    "start": window.start,
                    "time": window.train.time[0],
                    "methods": {
                        outcome.method: outcome.to_dict(question)
                        for outcome in row
                        if outcome.method in kept
                    },
                }
                for window, row in zip(part.windows, part.outcomes, strict=True)
            ],
        }


def _mean(shares: Iterable[float | None]) -> float | None:
    """Of those that there are."""
    finite = [share for share in shares if share is not None and not np.isnan(share)]
    return float(np.mean(finite)) if finite else None


def _geometric(values: Sequence[float]) -> float:
    with np.errstate(divide="ignore"):
        return np.exp(np.mean(np.log(values)))
