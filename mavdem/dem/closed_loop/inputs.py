"""Cautions about recorded inputs: hardly moving, saturated, not motors, or of a controller that changed.

A model relates the motion to what the inputs did. Where they did not do what the controller wanted, or the controller
or the vehicle is another one from some instant on, it holds for none of the flight.
"""

from __future__ import annotations

from functools import reduce
from operator import add

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.forecast.var import ChannelUnits, LagStatistics, Var
from mavdem.dem.record import Record

MOTORS = 3  # inputs, from which on they are taken for a multirotor's motors

HARDLY_MOVES = 0.03
"""Standard deviation over the median one of all inputs. The quietest motor of any recorded flight had 0.13."""

LIMIT_WIDTH = 0.005  # of a channel's range: what is so near to its lowest or highest value is at it
LIMIT_SHARE = 0.02  # of the samples at it, from which there is a caution
LIMIT_RATIO = 4.0  # of the number at it over the number as near to those: a sine has 2.4, quantised noise less than 1

LEVEL_DEVIATIONS, LEVEL_SHARE = 10.0, 0.05
"""Of the motors' mean level in a part from that of all: over its median deviation, and over the level itself."""

PARTS = 8  # of the training data, in time: each is compared with those on either side of a split
SPLITS = (2, 4, 6)  # parts before the change
LAGS = 4
LAG_SECONDS = 0.01  # between two lags, or one sample: faster ones say little but noise
CHANGED = 0.5
"""Log of the squared one-step errors of the inputs, by a model of the other side of a split over one of the same side.
19 of 20 windows of recorded flights have at most 0.1, and 4 of 5 in which the vehicle changes more than 0.5."""


def input_cautions(record: Record) -> tuple[str, ...]:
    """One sentence for each thing that is wrong with the inputs of training data; none for most flights."""
    motors = record.inputs.shape[1] >= MOTORS
    found = [_hardly_moving(record), _not_motors(record) if motors else "", _saturated(record)]
    found += [_level(record) if motors else "", _changed(record)]
    return tuple(caution for caution in found if caution)


def _name(record: Record, column: int) -> str:
    return record.input_names[column] if record.input_names else f"input {column + 1}"


def _hardly_moving(record: Record) -> str:
    """Of one input that is nearly constant beside the others: a motor that is missing, or another channel."""
    sizes = record.inputs.std(axis=0)
    still = np.flatnonzero(sizes < HARDLY_MOVES * np.median(sizes))
    if not len(still):
        return ""
    return (
        f"{_name(record, still[0])} hardly moves beside the others: it may be no motor of this vehicle, and its "
        "effect is not determined. Leave it out, or check which channels are the motors."
    )


def _saturated(record: Record) -> str:
    """Of the input that is at its lowest or highest value most often, more often than near to it."""
    worst, sentence = LIMIT_SHARE, ""
    for column, values in enumerate(record.inputs.T):
        for side, distance in (("highest", values.max() - values), ("lowest", values - values.min())):
            share = _share_at_limit(distance)
            if share >= worst:
                limit = values.max() if side == "highest" else values.min()
                worst = share
                sentence = (
                    f"{_name(record, column)} is saturated: in {share:.0%} of the samples it is at its {side} value, "
                    f"{limit:.5g}. There the controller wanted more than the motors gave. Learn from a calmer part of "
                    "the flight."
                )
    return sentence


def _share_at_limit(distance: Array) -> float:
    """The share of samples at distance 0, or 0 where as many are near by; ``distance`` (T,) is at least 0."""
    levels = np.unique(distance)
    if len(levels) < 3:
        return 0.0
    # A quantised channel is at the limit within half a quantum.
    quantum, whole = float(levels[1]), float(levels[-1])
    width = max(LIMIT_WIDTH * whole, 0.5 * quantum)
    at = np.count_nonzero(distance < width)
    near = np.count_nonzero((distance >= width) & (distance < width + max(width, quantum)))
    return float(at / len(distance)) if at >= LIMIT_RATIO and at >= LIMIT_RATIO * near else 0.0


def _not_motors(record: Record) -> str:
    """Of inputs of both signs, as demands of roll, pitch, yaw and thrust are: motors turn in one direction."""
    both = (record.inputs.min(axis=0) < 0) & (record.inputs.max(axis=0) > 0)
    if not both.any():
        return ""
    return (
        f"{_name(record, int(np.argmax(both)))} has both signs, as a controller's demand has, but {len(both)} inputs "
        "are taken for motors. Give motor outputs as they were recorded, or the demand of this axis alone."
    )


def _level(record: Record) -> str:
    """Of the motors' mean where it leaves its usual range for a part of the training data: ground or landing."""
    level = record.inputs.mean(axis=1)
    deviation = np.abs(level - np.median(level))
    usual = max(LEVEL_DEVIATIONS * np.median(deviation), LEVEL_SHARE * abs(np.median(level)))
    parts = np.array([np.median(part) for part in np.array_split(deviation, PARTS)])
    if not parts.max() > usual:
        return ""
    return (
        f"{_when(record, int(np.argmax(parts)))} the motors' mean is far from its usual level, as on the ground, in a "
        "take-off or in a landing. Learn from the rest of the flight."
    )


def _when(record: Record, part: int) -> str:
    return f"About {(part + 0.5) / PARTS * len(record) * record.dt:.2g} s into the training data"


def _changed(record: Record) -> str:
    """Of inputs that follow the motion in another way on either side of a split, by joint autoregressions.

    Each part is predicted by a model of its own side without it, and by one of the other side. Where nothing changed
    both have the same errors; a side that is merely calmer than the other is predicted well by the other.
    """
    step = max(1, round(LAG_SECONDS / record.dt))
    segments = [channels[::step] for channels in ChannelUnits.of(record).segments(record)]
    parts = [LagStatistics.of([part], LAGS) for part in np.array_split(np.concatenate(segments), PARTS)]
    if min(part.rows for part in parts) < LAGS * (record.inputs.shape[1] + record.outputs.shape[1]):
        return ""
    by_split = [_difference(parts, split, record.outputs.shape[1]) for split in SPLITS]
    if not max(by_split) > CHANGED:
        return ""
    seconds = SPLITS[int(np.argmax(by_split))] / PARTS * len(record) * record.dt
    return (
        f"About {seconds:.2g} s into the training data the inputs begin to follow the motion in another way: a new "
        "flight mode, a landing, a motor that fails, or another load. Learn from one side of it."
    )


def _difference(parts: list[LagStatistics], split: int, outputs: int) -> float:
    """Mean log error ratio of the side that is less different; a negative one means that the other side is as good."""
    before, after = reduce(add, parts[:split]), reduce(add, parts[split:])
    models = Var.fit(before, LAGS), Var.fit(after, LAGS)
    ratios = []
    for number, part in enumerate(parts):
        own, other = (before, models[1]) if number < split else (after, models[0])
        left_out = Var.fit(own - part, LAGS)
        ratios.append(float(np.mean(np.log(_errors(other, part, outputs) / _errors(left_out, part, outputs)))))
    return min(float(np.mean(ratios[:split])), float(np.mean(ratios[split:])))


def _errors(model: Var, part: LagStatistics, outputs: int) -> Array:
    """(r,) squared one-step errors of the inputs in a part."""
    rows = np.hstack([-model.across, -model.offset[:, None], np.eye(len(model.offset))])[outputs:]
    errors: Array = np.maximum(np.einsum("ij,jk,ik->i", rows, part.gram, rows), np.finfo(float).tiny)
    return errors
