"""ModelLines: parameters, noise precisions and F̄ over time, one point for each new model."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.stats import norm

from mavdem.dem import Estimate, Learned, LinearModel
from mavdem.dem.engine.model import pack
from mavdem.dem.validation import LEVEL
from mavdem.report.names import entries, left_free, short
from mavdem.view import lines
from mavdem.view.learning import precision_names, prior_outweighs_data
from mavdem.view.live.line_group import LineGroup, around, band
from mavdem.view.live.rows import Channels, ViewRow

Array = NDArray[np.float64]

MODELS_PER_BATCH = 10  # A new model comes each tenth of a second, and a batch of one costs as much as one of a hundred


class ModelLines:
    """Draws the parameters that are learned."""

    def __init__(self, channels: Channels, root: str = "") -> None:
        self._channels, self._root = channels, root
        self.begin()

    def begin(self) -> None:
        """Starts a recording: nothing is drawn in it yet."""
        self._model: LinearModel | None = None
        self._learned: Learned | None = None
        self._inflation = np.empty(0)
        self._styled: set[LineGroup] = set()
        self._waiting: dict[LineGroup, list[tuple[float, Array]]] = defaultdict(list)
        self._models = 0

    def add(self, recording: rr.RecordingStream, rows: list[ViewRow]) -> None:
        """Adds the new models among the rows."""
        for row in rows:
            if row.estimate is None or row.estimate.model is None or row.estimate.model is self._model:
                continue
            self._model = row.estimate.model
            for group, values in self._points(row.estimate, row.learned):
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

    def _points(self, now: Estimate, learned: Learned | None) -> Iterator[tuple[LineGroup, Array]]:
        assert now.model is not None and now.model_sd is not None
        theta, sd = (pack(model.A, model.B, model.C) for model in (now.model, now.model_sd))
        if learned is not None and learned is not self._learned:
            self._learned, self._inflation = learned, inflation(learned)
        half = norm.ppf(0.5 + LEVEL / 2) * sd
        if self._learned is not None and len(self._inflation) == len(half):
            half = half * self._inflation
        for place, group in self._parameters(now.model):
            yield group, np.array(around(theta[place], half[place]))
        precisions, free = self._precisions(len(now.log_precisions))
        yield precisions, now.log_precisions[free]
        yield LineGroup("free_energy_action", ("F̄",), (lines.MEASURED,), (2.5,)), np.array([now.free_energy_action])

    def _parameters(self, model: LinearModel) -> Iterator[tuple[int, LineGroup]]:
        """The place in θ and the lines of each parameter that the prior does not fix."""
        first = 0
        for matrix, table in (("A", model.A), ("B", model.B), ("C", model.C)):
            free = np.ones(table.size, bool)
            cells = [(str(row + 1), str(column + 1)) for row, column in np.ndindex(*table.shape)]
            if self._learned is not None:
                free, cells = left_free(self._learned)[matrix], entries(self._channels, self._learned)[matrix]
            for colour, place in enumerate(np.flatnonzero(free)):
                row, column = cells[place]
                path = rr.new_entity_path(["parameters", matrix, f"{row} from {column}"])
                yield first + int(place), band(path, f"{row} ← {short(column)}", lines.distinct(colour), 2.5)
            first += table.size

    def _precisions(self, number: int) -> tuple[LineGroup, NDArray[np.bool_]]:
        """The lines of the λ that the prior does not fix, and which they are; all of them if it fixes all."""
        names, free = [f"λ {i + 1}" for i in range(number)], np.ones(number, bool)
        if self._learned is not None:
            names = precision_names(self._channels, self._learned)
            fixed = prior_outweighs_data(self._learned)
            free = fixed if fixed.all() else ~fixed
        shown = tuple(name for name, is_free in zip(names, free, strict=True) if is_free)
        colours, widths = tuple(map(lines.distinct, range(len(shown)))), (2.5,) * len(shown)
        return LineGroup(rr.new_entity_path(["noise_precisions", *shown]), shown, colours, widths), free


def inflation(learned: Learned) -> Array:
    """(k,) ratio of the sandwich standard deviation to that of DEM's posterior, at the last batch; 1 where unknown."""
    half, sd = learned.model_interval(LEVEL), learned.model_sd
    ratio = pack(half.A, half.B, half.C) / pack(sd.A, sd.B, sd.C) / norm.ppf(0.5 + LEVEL / 2)
    return np.where(np.isfinite(ratio) & (ratio > 0), ratio, 1.0)
