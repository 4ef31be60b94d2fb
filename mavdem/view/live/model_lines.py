"""Model lines: parameters, noise precisions and F̄ as they settle, one point for each new model."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.stats import norm

from mavdem.dem import Estimate, Learned, LinearModel
from mavdem.dem.model import pack
from mavdem.dem.priors import hyperparameter_groups
from mavdem.naming import entries, left_free, short, state_names
from mavdem.view import lines
from mavdem.view.live.bundle import Bundle, estimate
from mavdem.view.live.row import Channels, Row
from mavdem.view.outlook import LEVEL
from mavdem.view.parameters import by_group, prior_outweighs_data

Array = NDArray[np.float64]

TOGETHER = 10
"""New models that are sent at once: one comes each tenth of a second, and a batch of one costs as much as a hundred."""


class ModelLines:
    """What was learnt over time, of the parameters that are learnt at all."""

    def __init__(self, channels: Channels, root: str = "") -> None:
        self._channels, self._root = channels, root
        self.begin()

    def begin(self) -> None:
        """Nothing is drawn yet, of a recording that begins."""
        self._model: LinearModel | None = None
        self._learned: Learned | None = None
        self._inflation = np.empty(0)
        self._styled: set[Bundle] = set()
        self._waiting: dict[Bundle, list[tuple[float, Array]]] = defaultdict(list)
        self._models = 0

    def add(self, recording: rr.RecordingStream, rows: list[Row]) -> None:
        """Takes the models that are new among rows."""
        for row in rows:
            if row.estimate is None or row.estimate.model is None or row.estimate.model is self._model:
                continue
            self._model = row.estimate.model
            for bundle, values in self._points(row.estimate, row.learned):
                self._waiting[bundle.under(self._root)].append((row.time, values))
            self._models += 1
        if self._models >= TOGETHER:
            self.send(recording)

    def send(self, recording: rr.RecordingStream) -> None:
        """Sends what waits."""
        for bundle, points in self._waiting.items():
            if bundle not in self._styled:
                bundle.send_style(recording)
                self._styled.add(bundle)
            bundle.send(recording, np.array([time for time, _ in points]), np.array([values for _, values in points]))
        self._waiting.clear()
        self._models = 0

    def _points(self, now: Estimate, learned: Learned | None) -> Iterator[tuple[Bundle, Array]]:
        assert now.model is not None and now.model_sd is not None
        theta, sd = (pack(model.A, model.B, model.C) for model in (now.model, now.model_sd))
        if learned is not None and learned is not self._learned:
            self._learned, self._inflation = learned, inflation(learned)
        half = norm.ppf(0.5 + LEVEL / 2) * sd
        if self._learned is not None and len(self._inflation) == len(half):
            half = half * self._inflation
        for place, bundle in self._parameters(now.model):
            yield bundle, np.array([theta[place] - half[place], theta[place] + half[place], theta[place]])
        precisions, free = self._precisions(len(now.log_precisions))
        yield precisions, now.log_precisions[free]
        yield Bundle("free_energy_action", ("F̄",), (lines.MEASURED,), (2.5,)), np.array([now.free_energy_action])

    def _parameters(self, model: LinearModel) -> Iterator[tuple[int, Bundle]]:
        """The place in θ and the lines of each parameter that the prior left to the data."""
        first = 0
        for matrix, table in (("A", model.A), ("B", model.B), ("C", model.C)):
            free = np.ones(table.size, bool)
            cells = [(str(row + 1), str(column + 1)) for row, column in np.ndindex(*table.shape)]
            if self._learned is not None:
                free, cells = left_free(self._learned)[matrix], entries(self._channels, self._learned)[matrix]
            for colour, place in enumerate(np.flatnonzero(free)):
                row, column = cells[place]
                path = rr.new_entity_path(["parameters", matrix, f"{row} from {column}"])
                yield first + int(place), estimate(path, f"{row} ← {short(column)}", lines.distinct(colour))
            first += table.size

    def _precisions(self, number: int) -> tuple[Bundle, NDArray[np.bool_]]:
        """The lines of those λ that the prior left to the data, and which these are; all, where it fixed all."""
        names, free = [f"λ {i + 1}" for i in range(number)], np.ones(number, bool)
        if self._learned is not None:
            states = state_names(self._channels, self._learned)
            outputs = self._channels.output_names
            of_outputs, of_states = hyperparameter_groups(self._learned.settings, len(states), len(outputs))
            names = by_group("z", outputs, of_outputs) + by_group("w", states, of_states)
            fixed = prior_outweighs_data(self._learned)
            free = fixed if fixed.all() else ~fixed
        shown = tuple(name for name, left in zip(names, free, strict=True) if left)
        colours, widths = tuple(map(lines.distinct, range(len(shown)))), (2.5,) * len(shown)
        return Bundle(rr.new_entity_path(["noise_precisions", *shown]), shown, colours, widths), free


def inflation(learned: Learned) -> Array:
    """(k,) how many times as wide as DEM's posterior says, by the scatter of the estimate; 1 where that is not known.

    The posterior counts neighbouring samples as independent. The scatter takes a whole learning to find; until the
    next, it is taken to be as many times wider.
    """
    half, sd = learned.model_interval(LEVEL), learned.model_sd
    ratio = pack(half.A, half.B, half.C) / pack(sd.A, sd.B, sd.C) / norm.ppf(0.5 + LEVEL / 2)
    return np.where(np.isfinite(ratio) & (ratio > 0), ratio, 1.0)
