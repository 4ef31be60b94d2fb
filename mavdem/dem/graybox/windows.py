"""Windows of a flight for the gray-box model: one length, one trim, one unit of the inputs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.engine.linalg import Array
from mavdem.dem.graybox.likelihood import FlightWindows
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record

WINDOW_SECONDS, SHORTEST_WINDOW_SECONDS = 7.0, 2.0
MIN_SAMPLES = 200
FEWEST_RATE = 39.0
"""Hz: of fewer samples, a lag and damping of tens of milliseconds are no more than a guess. A grid of 40 Hz may have a
little less."""
FASTEST_RATE = 199.0  # Hz: of twice that or more, every so many samples are taken


class Cut(NamedTuple):
    """A record in W windows of N samples.

    Attributes:
        windows: what is fitted.
        starts: (W,) s of the record before each.
        unit: of the windows' inputs, in the unit of the record's.
        outputs: (W, N, m).
        setpoints: (W, N, q), NaN where they are not known; ``None`` where there are none.
        setpoint_names: of their columns.
    """

    windows: FlightWindows
    starts: Array
    unit: float
    outputs: Array
    setpoints: Array | None
    setpoint_names: tuple[str, ...]


def cut(record: Record) -> Cut:
    """Cuts a record into windows.

    Raises:
        ValueError: no output is the rate of another, there are too few samples, or no motor moves.
    """
    if 1 / record.dt < FEWEST_RATE:
        raise ValueError(
            "motors' effect, damping, lag and poles show at several Hz, which needs 40 samples a second, not "
            f"{1 / record.dt:.3g}"
        )
    if not record.inputs.std(axis=0).any():
        raise ValueError("physical parameters need motors that move: all inputs are constant")
    rate = rate_column(record)
    places = _places(record)
    inputs = record.inputs[places]
    inputs = inputs - inputs.mean(axis=(0, 1))
    unit = float(np.sqrt(np.mean(inputs**2)))
    if not unit:
        raise ValueError("physical parameters need motors that move: all inputs are constant")
    step = int(places[0, 1] - places[0, 0])
    windows = FlightWindows(inputs / unit, record.outputs[places, rate], step * record.dt)
    return Cut(
        windows,
        np.asarray(record.dt * places[:, 0]),
        unit,
        record.outputs[places],
        None if record.setpoints is None else record.setpoints[places],
        record.setpoint_names,
    )


def rate_column(record: Record) -> int:
    """Which output is the rate: the derivative of another, or the only one; ``ValueError`` where none is."""
    if record.outputs.shape[1] == 1:
        return 0
    pairs = derivative_pairs(record)
    if not pairs:
        raise ValueError("physical parameters need an angle and its rate: no output is the derivative of another")
    return pairs[0][1]


def _places(record: Record) -> NDArray[np.intp]:
    """(W, N) samples of each window."""
    step = max(1, int(1 / record.dt / FASTEST_RATE))
    shortest = max(step * MIN_SAMPLES, round(SHORTEST_WINDOW_SECONDS / record.dt))
    if record.longest < shortest:
        raise ValueError(
            f"physical parameters need at least {shortest} samples without long gaps, not {record.longest}"
        )
    # Up to half as long again, or down to what there is, so that as little as possible is left over.
    usual = min(round(WINDOW_SECONDS / record.dt), record.longest)
    lengths = [length for length in range(usual, int(1.5 * usual) + 1, max(1, usual // 50)) if length <= record.longest]
    length = max(lengths, key=lambda length: sum(own // length for own in record.lengths) * length)
    begins = np.concatenate(
        [start + length * np.arange(own // length) for start, own in zip(record.starts, record.lengths, strict=True)]
    )
    return np.asarray(begins[:, None] + np.arange(0, length - step + 1, step), np.intp)
