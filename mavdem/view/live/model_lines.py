"""ModelLines: parameters, noise precisions and F̄ over time, one point for each new model."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mavdem.dem import Estimate, Learned, LinearModel
from mavdem.report.numbers import entries, left_free, place
from mavdem.report.palette import MEASURED, distinct
from mavdem.view.learning import precision_names, prior_outweighs_data, scales
from mavdem.view.live.line_group import LineGroup
from mavdem.view.live.rows import Channels, ViewRow

Array = NDArray[np.float64]

MODELS_PER_BATCH = 10  # A new model comes each tenth of a second, and a batch of one costs as much as one of a hundred


class ModelLines:
    """Draws what the prior leaves free, in degrees."""

    def __init__(self, channels: Channels, root: str = "") -> None:
        self._channels, self._root = channels, root
        self.begin()

    def begin(self) -> None:
        """Starts a recording: nothing is drawn in it yet."""
        self._model: LinearModel | None = None
        self._styled: set[LineGroup] = set()
        self._waiting: dict[LineGroup, list[tuple[float, Array]]] = defaultdict(list)
        self._models = 0

    def add(self, recording: rr.RecordingStream, rows: list[ViewRow]) -> None:
        """Adds the new models among the rows."""
        for row in rows:
            if row.estimate is None or row.estimate.model is None or row.estimate.model is self._model:
                continue
            self._model = row.estimate.model
            for group, values in self._points(row.estimate, self._model, row.learned):
                self._waiting[group.under(self._root)].append((row.time, values))
            self._models += 1
        if self._models >= MODELS_PER_BATCH:
            self.send(recording)

    def send(self, recording: rr.RecordingStream) -> None:
        """Sends the points that wait."""
        for group, points in self._waiting.items():
            if group not in self._styled:
                group.send_style(recording)
                self._styled.add(group)
            group.send(recording, np.array([time for time, _ in points]), np.array([values for _, values in points]))
        self._waiting.clear()
        self._models = 0

    def _points(self, now: Estimate, model: LinearModel, learned: Learned | None) -> Iterator[tuple[LineGroup, Array]]:
        """An entity for each matrix, λ and F̄; which entries are free is known from the first batch on."""
        precisions = now.log_precisions
        if learned is not None:
            cells, free, scale = entries(self._channels, learned), left_free(learned), scales(self._channels, learned)
            for name, matrix in (("A", model.A), ("B", model.B), ("C", model.C)):
                shown = np.flatnonzero(free[name])
                if len(shown):
                    labels = (f"{place(row)} ← {place(column)}" for row, column in (cells[name][i] for i in shown))
                    yield _lines(f"parameters/{name}", tuple(labels)), (scale[name] * matrix.ravel())[shown]
            fixed = prior_outweighs_data(learned)
            shown = np.flatnonzero(fixed if fixed.all() else ~fixed)
            names = precision_names(self._channels, learned)
            yield _lines("noise_precisions", tuple(names[i] for i in shown)), precisions[shown]
        yield LineGroup("free_energy_action", ("F̄",), (MEASURED,), 2.0), np.array([now.free_energy_action])


def _lines(path: str, names: tuple[str, ...]) -> LineGroup:
    return LineGroup(path, names, tuple(map(distinct, range(len(names)))), 2.0)
