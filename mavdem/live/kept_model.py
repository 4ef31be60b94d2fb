"""The last good model of a flight, beside the newest: judged by its forecasts of samples that came after it.

The newest samples may be of a landing nobody recognised, or of a hover too still to learn from.
"""

from __future__ import annotations

from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mavdem.alignment.signals import axis_outputs
from mavdem.dem import Learned, OnlineLearner
from mavdem.dem.learning import learn
from mavdem.dem.record import Record
from mavdem.live.aligner import Setup

HORIZON_SECONDS = 0.25  # Of the forecasts that are judged
MIN_SAMPLES = 100  # That come after a model, to judge it by
GOOD_ERROR = 0.1  # Of the variance: a newest model with less is written without further question
CLEARLY_WORSE = 1.5  # Ratio of errors: half of the memory makes a somewhat worse model than all of it


def forecast_error(learned: Learned, after: Record) -> float:
    """Mean squared error of forecasts over ``HORIZON_SECONDS`` in variances of the samples, outputs averaged.

    It is of the longest segment ``after`` the training data; NaN if it has fewer than ``MIN_SAMPLES`` to judge by, and
    infinite if forecasts overflow, and for other inputs or another step.
    """
    inputs, outputs = max(after.segments, key=lambda segment: len(segment[1]))
    if (learned.record.dt, learned.record.inputs.shape[1]) != (after.dt, inputs.shape[1]):
        return np.inf
    steps = max(round(HORIZON_SECONDS / after.dt), 1)
    first = 4 * steps  # the filter first finds the state, which samples before these have changed
    if len(outputs) < first + MIN_SAMPLES or not np.all(outputs.var(axis=0)):
        return np.nan
    try:
        forecast = learned.forecast_every(steps, inputs, outputs)
    except ValueError:
        return np.inf
    errors = (forecast - outputs)[first:]
    return float(np.mean(np.mean(errors**2, axis=0) / outputs.var(axis=0)))


class DatedModel(NamedTuple):
    """A model, and the boot clock, s, when it was learnt."""

    learned: Learned
    time: float


class KeptModel:
    """The better of the models that were followed by samples: ``model``, None before the first.

    Each is judged once the next one has come, by the later half of that one's training data, in the ``executor`` or in
    this process.
    """

    def __init__(self, executor: Executor | None) -> None:
        self.model: DatedModel | None = None
        self._executor = executor
        self._newest: DatedModel | None = None
        self._pending: tuple[DatedModel, Future[bool]] | None = None

    def take(self, learned: Learned | None, time: float) -> None:
        """Takes the latest result of ``learn`` at ``time``, s of the boot clock."""
        if self._pending is not None and self._pending[1].done():
            (judged, future), self._pending = self._pending, None
            if future.cancelled() or future.exception() is not None or future.result():
                self.model = judged
        before = self._newest
        if learned is None or (before is not None and learned is before.learned):
            return
        self._newest = DatedModel(learned, time)
        if before is None:
            return
        if self.model is None:
            self.model = before
        elif self._pending is None:
            self._judge(before, self.model, learned.record.halves()[1])

    def _judge(self, one: DatedModel, other: DatedModel, after: Record) -> None:
        if self._executor is not None:
            self._pending = one, self._executor.submit(is_no_worse, one.learned, other.learned, after)
        elif is_no_worse(one.learned, other.learned, after):
            self.model = one

    def choose(self, learner: OnlineLearner) -> tuple[Learned, str]:
        """The model to write, and in one sentence why it is not the newest; "" if it is.

        The newest is judged by what half of its samples make of the other half.

        Raises:
            ValueError: there is none.
        """
        try:
            newest = learner.learn_now()
        except ValueError as error:
            if self.model is None:
                raise
            return self.model.learned, f"The newest samples support no model ({error}): {_instead(self.model)}"
        if self.model is None:
            return newest, ""
        before, after = newest.record.halves()
        try:
            own = forecast_error(learn(before, newest.settings), after)
        except ValueError:
            own = np.inf
        former = forecast_error(self.model.learned, after)
        if not own > max(GOOD_ERROR, CLEARLY_WORSE * former):
            return newest, ""
        errors = f"forecasts over {HORIZON_SECONDS:g} s leave {own:.2g} of the variance, with the former {former:.2g}"
        return self.model.learned, f"The newest samples make a poor model ({errors}): {_instead(self.model)}"


def is_no_worse(one: Learned, other: Learned, after: Record) -> bool:
    """Whether ``one`` forecasts the samples ``after`` both as well as the ``other``; True if they cannot say."""
    return not forecast_error(one, after) > forecast_error(other, after)


def named(learned: Learned, setup: Setup | None, axis: str) -> Learned:
    """The model with the names and units of the rows of a ``setup`` about an ``axis``, where it has its inputs."""
    inputs = () if setup is None else setup.layout.names
    if setup is None or learned.record.inputs.shape[1] != len(inputs):
        return learned
    names, units = zip(*axis_outputs(axis), strict=True)
    record = replace(
        learned.record,
        input_names=inputs,
        output_names=names,
        input_units=(setup.scale.unit,) * len(inputs),
        output_units=units,
    )
    return replace(learned, record=record)


def _instead(model: DatedModel) -> str:
    return f"the model learned at {model.time:.0f} s of the boot clock is kept."
