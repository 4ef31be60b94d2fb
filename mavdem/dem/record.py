"""The training data of a model: uniformly sampled segments of a flight, with gaps that no computation crosses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from mavdem.arrays import Array, Flags, Indices, as_real_array
from mavdem.containers import JsonValues, Names, Numbers
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE
from mavdem.dem.validation import (
    MAX_ABS_VALUE,
    require_finite_and_bounded,
    validated_count,
    validated_directions,
    validated_step,
    validated_table,
)
from mavdem.errors import NotLearnable
from mavdem.facts.model import ModelRefusal


class SegmentSamples(NamedTuple):
    """The samples of a segment, or of a piece of one: T, which may differ from segment to segment."""

    inputs: Array
    """(T, r) inputs."""

    outputs: Array
    """(T, m) outputs."""


Segments = list[SegmentSamples]
"""The samples of each segment."""

STEP_TOLERANCE = 1e-6
"""Relative difference that the sampling steps of segments may have: rounding only."""

MIN_MOTORS = 3
"""Fewest inputs that are assumed to be the motors of a multirotor."""

LABEL_FIELDS = ("input_names", "output_names", "input_units", "output_units")
"""Attributes of a flight and fields of a record with one string for each column."""


class ChannelStatistics(NamedTuple):
    """Statistics of each of k channels over all samples of a record.

    Attributes:
        mean: (k,) means, in the channels' units.
        variance: (k,) variances, in the squares of these units.
        lowest: (k,) smallest samples.
        highest: (k,) largest samples.
    """

    mean: Array
    variance: Array
    lowest: Array
    highest: Array

    @classmethod
    def from_samples(cls, samples: Array) -> ChannelStatistics:
        """Returns the statistics of samples (T, k)."""
        return cls(
            samples.mean(axis=0), samples.var(axis=0), samples.min(axis=0), samples.max(axis=0)
        )

    @property
    def varying(self) -> Flags:
        """Which channels vary by more than rounding, (k,) booleans: the others are constant, and teach nothing."""
        size = np.maximum(abs(self.lowest), abs(self.highest))
        # The inverse of the largest value is the smallest whose square does not vanish.
        return self.highest - self.lowest > np.maximum(ROUNDING_TOLERANCE * size, 1 / MAX_ABS_VALUE)


class RecordStatistics(NamedTuple):
    """Statistics of the channels of a record."""

    inputs: ChannelStatistics
    """Of the r inputs."""

    outputs: ChannelStatistics
    """Of the m outputs."""


class UniformSamples(Protocol):
    """What ``learn`` needs of a flight: inputs (T, r), outputs (T, m) and the sampling step, s.

    If it also has ``effect_directions``, ``time``, setpoints, or names and units of its columns, they are used.
    """

    @property
    def inputs(self) -> Array: ...  # noqa: D102
    @property
    def outputs(self) -> Array: ...  # noqa: D102
    @property
    def dt(self) -> float: ...  # noqa: D102


TrainingData = UniformSamples | Sequence[UniformSamples]
"""A flight, or the segments of one."""


class FoldPiece(NamedTuple):
    """Consecutive samples of one segment that belong to a fold of a cross-validation.

    Attributes:
        segment: Number of the segment, from 0.
        first: First sample of the piece within the segment.
        stop: Sample after the last of the piece.
    """

    segment: int
    first: int
    stop: int


@dataclass(frozen=True, eq=False)
class Record:
    """The samples of all segments one after another, in physical units: T samples, r inputs, m outputs.

    Its fields are keys of the JSON document of a model.

    Attributes:
        inputs: (T, r) motor outputs, in the unit of the stream.
        outputs: (T, m) measured motion: angle (rad) and rate (rad/s), or the rate only.
        dt: Sampling step, s.
        lengths: Number of samples of each segment; their sum is T.
        effect_directions: (r,) relative effect of each motor on the axis, if the mixer geometry is known.
        begins: Time of each segment's first sample on the flight's clock, s; empty if the flight has no clock.
        input_names, output_names: Name of each column; may be empty.
        input_units, output_units: Unit of each column; may be empty.
        parameters: Parameters of the autopilot's controller, by name.
        earlier: Values that some of these parameters had before they changed in flight or later, by name.
        input_range: Inputs at no and at full throttle, where they are known; otherwise empty.
        setpoints: (T, q) setpoints of the outer loops for the axis, NaN where there is none; None if not recorded.
        setpoint_names: Name of each column of ``setpoints``.

    Raises:
        ValueError: A shape does not fit, or a value is not finite or too large.
    """

    inputs: Array
    outputs: Array
    dt: float
    lengths: tuple[int, ...]
    effect_directions: Array | None = None
    begins: Numbers = ()
    input_names: Names = ()
    output_names: Names = ()
    input_units: Names = ()
    output_units: Names = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    earlier: Mapping[str, float] = field(default_factory=dict)
    input_range: Numbers = ()
    setpoints: Array | None = None
    setpoint_names: Names = ()

    def __post_init__(self) -> None:
        """Checks values and shapes, also of a record that was read from a document.

        Raises:
            ValueError: A table or the step is wrong; the message names it.
        """
        validated_step(self.dt)
        require_finite_and_bounded(self.inputs, "inputs")
        require_finite_and_bounded(self.outputs, "outputs")
        # Both tables must have one row for each sample of all segments.
        sample_count = sum(self.lengths)
        shapes = [table.shape for table in (self.inputs, self.outputs)]
        if not sample_count or any(len(shape) != 2 or shape[0] != sample_count for shape in shapes):
            raise ValueError(
                f"inputs and outputs must be tables of {sample_count} rows, the sum of lengths"
            )
        directions = self.effect_directions
        if directions is not None and directions.shape != self.inputs.shape[1:]:
            raise ValueError("effect_directions must have a number for each column of inputs")

    @classmethod
    def from_flights(cls, train: TrainingData) -> Record:
        """Joins a flight, or segments of one sampled at the same rate, to a record.

        Args:
            train: A ``Flight`` or an object with the same attributes, a sequence of them, or a record, which is
                returned unchanged.

        Returns:
            The record; names and units of the columns are taken from the first segment.

        Raises:
            ValueError: The segments have different columns or sampling steps, or values are wrong; the message names
                the argument.
        """
        if isinstance(train, Record):
            return train
        flights = train if isinstance(train, Sequence) else [train]
        if not flights:
            raise ValueError("train must hold at least one segment")
        # Each segment is checked alone, and then compared with the others.
        samples = [_checked_samples(flight) for flight in flights]
        inputs = [segment.inputs for segment in samples]
        outputs = [segment.outputs for segment in samples]
        _require_same_columns(inputs, "inputs")
        _require_same_columns(outputs, "outputs")
        dt = _common_step([segment.dt for segment in samples])
        # Names and units of the columns, which only a Flight has.
        labels: JsonValues = {name: tuple(getattr(flights[0], name, ())) for name in LABEL_FIELDS}
        return cls(
            inputs=np.concatenate(inputs),
            outputs=np.concatenate(outputs),
            dt=dt,
            lengths=tuple(len(table) for table in outputs),
            effect_directions=_common_directions(flights, inputs[0].shape[1]),
            begins=_start_times(flights),
            **labels,
            **_controller_fields(flights),
        )

    def __len__(self) -> int:
        return len(self.outputs)

    @cached_property
    def segment_starts(self) -> Indices:
        """Index of each segment's first sample, (segments,)."""
        return np.cumsum([0, *self.lengths[:-1]])

    @cached_property
    def channel_statistics(self) -> RecordStatistics:
        """Statistics of the inputs and of the outputs."""
        return RecordStatistics(
            inputs=ChannelStatistics.from_samples(self.inputs),
            outputs=ChannelStatistics.from_samples(self.outputs),
        )

    def require_varying(self, *, known_inputs: bool) -> None:
        """Checks that all channels vary, since a relation of a constant channel to others cannot be learned.

        Args:
            known_inputs: Whether the model uses the inputs, so that they must vary too.

        Raises:
            NotLearnable: An output, or an input that the model uses, is constant.
        """
        inputs, outputs = self.channel_statistics
        # Inputs that the model does not use may be constant.
        constant_by_name = {"inputs": ~inputs.varying & known_inputs, "outputs": ~outputs.varying}
        for name, is_constant in constant_by_name.items():
            columns = np.flatnonzero(is_constant)
            if len(columns):
                raise NotLearnable(
                    ModelRefusal.CHANNEL_CONSTANT,
                    subject=f"{name} column {columns[0]}",
                    others_vary=name == "inputs" and len(columns) < len(is_constant),
                )

    @property
    def segments(self) -> Segments:
        """Inputs and outputs of each segment."""
        later_segment_starts = self.segment_starts[1:]
        segments = zip(
            np.split(self.inputs, later_segment_starts),
            np.split(self.outputs, later_segment_starts),
            strict=True,
        )
        return [SegmentSamples(inputs, outputs) for inputs, outputs in segments]

    @property
    def longest_segment(self) -> int:
        """Number of samples of the longest segment."""
        return max(self.lengths)

    def window_count(self, window: int) -> int:
        """Returns the number of windows of ``window`` consecutive samples that lie within a segment."""
        return sum(max(0, length - window + 1) for length in self.lengths)

    def validated_inputs(self, inputs: ArrayLike) -> Array:
        """Checks inputs after the end of the record, for a forecast.

        Args:
            inputs: Inputs, (H, r), in the unit of the record's inputs; (H,) is accepted for a single input.

        Returns:
            The inputs as an array, (H, r).

        Raises:
            ValueError: The inputs have another shape, or a value is not finite.
        """
        return validated_table(inputs, "inputs", self.inputs.shape[1])

    def validated_samples(
        self, steps: int, inputs: ArrayLike, outputs: ArrayLike
    ) -> SegmentSamples:
        """Checks samples after the end of the record, for forecasts that begin again at every ``steps``-th of them.

        Args:
            steps: Number of samples from the beginning of one forecast to the beginning of the next, at least 1.
            inputs: Inputs, (H, r).
            outputs: Outputs, (H, m), of the same samples.

        Returns:
            Inputs and outputs as arrays, (H, r) and (H, m).

        Raises:
            ValueError: An argument is wrong, or the two tables differ in length; the message names the argument.
        """
        validated_count(steps)
        checked_inputs = self.validated_inputs(inputs)
        checked_outputs = validated_table(outputs, "outputs", self.outputs.shape[1])
        if len(checked_inputs) != len(checked_outputs):
            raise ValueError(
                "inputs and outputs must be of the same samples, "
                f"not {len(checked_inputs)} and {len(checked_outputs)}"
            )
        return SegmentSamples(checked_inputs, checked_outputs)


def cross_validation_folds(lengths: Sequence[int], count: int) -> list[list[FoldPiece]]:
    """Divides the samples of segments into consecutive folds of about equal length.

    Args:
        lengths: Number of samples of each segment.
        count: Number of folds; fewer are returned if there are fewer samples, since no fold is empty.

    Returns:
        The pieces of each fold in order: one for each segment of which the fold contains samples.
    """
    sample_count = sum(lengths)
    folds = []
    for fold_number in range(count):
        # Range of the fold's samples, counted over all segments. Its overlap with each segment is a piece.
        fold_start = sample_count * fold_number // count
        fold_stop = sample_count * (fold_number + 1) // count
        segment_start = 0
        pieces = []
        for segment, length in enumerate(lengths):
            first_sample = max(fold_start - segment_start, 0)
            stop_sample = min(fold_stop - segment_start, length)
            if first_sample < stop_sample:
                pieces.append(FoldPiece(segment, first_sample, stop_sample))
            segment_start += length
        if pieces:
            folds.append(pieces)
    return folds


class _Samples(NamedTuple):
    """Checked samples of one segment: inputs (T, r), outputs (T, m) and the sampling step, s."""

    inputs: Array
    outputs: Array
    dt: float


def _checked_samples(segment: UniformSamples) -> _Samples:
    """Returns the samples of one segment as arrays, of a ``Flight`` or of anything with its attributes.

    Args:
        segment: The segment, with inputs (T, r), outputs (T, m) and dt, s. If it came from the user, it may be
            anything.

    Returns:
        The samples, as arrays of real numbers.

    Raises:
        ValueError: An attribute is missing or is not a number, or the tables have other shapes or no columns.
    """
    # An object without these attributes, or with values that are not numbers, leads to one and the same message.
    try:
        inputs = as_real_array(segment.inputs, "inputs")
        outputs = as_real_array(segment.outputs, "outputs")
        dt = float(as_real_array(segment.dt, "dt"))
    except (AttributeError, TypeError) as error:
        raise ValueError(
            f"train must be a Flight, or have inputs, outputs and dt like one: {error}"
        ) from None
    if inputs.ndim != 2 or outputs.ndim != 2 or len(inputs) != len(outputs):
        raise ValueError(
            f"inputs and outputs must be (T, r) and (T, m), not {inputs.shape} and {outputs.shape}"
        )
    if not (inputs.shape[1] and outputs.shape[1]):
        raise ValueError(
            f"inputs and outputs must have at least one column, not {inputs.shape} and {outputs.shape}"
        )
    return _Samples(inputs, outputs, dt)


def _require_same_columns(tables: Sequence[Array], name: str) -> None:
    """Raises ``ValueError``, with this ``name``, unless the tables of all segments have as many columns."""
    widths = [table.shape[1] for table in tables]
    if len(set(widths)) > 1:
        raise ValueError(f"{name} must have as many columns in every segment, not {widths}")


def _common_step(steps: Sequence[float]) -> float:
    """Returns the sampling step of all segments, s; raises ``ValueError`` if they differ by more than rounding."""
    if np.ptp(steps) > STEP_TOLERANCE * steps[0]:
        raise ValueError(
            f"dt must be the same in every segment, not between {min(steps)} and {max(steps)} s"
        )
    return steps[0]


def _start_times(segments: Sequence[UniformSamples]) -> Numbers:
    """Returns the time of each segment's first sample on the flight's clock.

    Segments that were made from arrays without stamps have no ``time``. A record stores either a time for every
    segment, or none.

    Args:
        segments: The segments of the flight that a model was learned from.

    Returns:
        Times, s; empty if a segment has no time.
    """
    times: list[Sequence[float]] = [getattr(segment, "time", ()) for segment in segments]
    if not all(len(time) for time in times):
        return ()
    return tuple(float(time[0]) for time in times)


def _common_directions(flights: Sequence[UniformSamples], motors: int) -> Array | None:
    """Returns the effect directions, if they are the same in all segments.

    Args:
        flights: The segments; an effect direction is the relative effect of a motor on the axis, by the mixer geometry.
        motors: Number of inputs, r.

    Returns:
        (r,) directions; None if they differ between segments, if a segment has none, or if all are zero.

    Raises:
        ValueError: The directions of a segment are not r finite numbers.
    """
    directions = []
    for flight in flights:
        # Samples that are not a Flight may lack this attribute.
        directions_of_segment = getattr(flight, "effect_directions", None)
        if directions_of_segment is not None:
            directions.append(validated_directions(directions_of_segment, motors))
    some_segment_has_none = len(directions) < len(flights)
    if some_segment_has_none or not directions[0].any():
        return None
    if not all(np.array_equal(values, directions[0]) for values in directions):
        return None
    return directions[0]


def _controller_fields(flights: Sequence[UniformSamples]) -> JsonValues:
    """Returns the fields of a record that describe the controller, as far as the segments have them.

    These are its parameters, the range of the inputs, and the setpoints if all segments have setpoints of the same
    names. The segments of a record are of one flight, so the ``provenance`` of the first, which describes their
    origin, holds for all.

    Args:
        flights: The segments, at least one. Only segments of the class ``Flight`` have the attributes that are read
            here. ``provenance["parameters"]`` are the autopilot's parameters by name, ``provenance["earlier"]`` their
            values before a change, and ``provenance["scale"]`` the inputs at no throttle, "low", and at full throttle,
            "high".

    Returns:
        Values of the fields ``parameters``, ``earlier`` and ``input_range`` of :class:`Record`, and of ``setpoints``
        and ``setpoint_names`` if there are setpoints.
    """
    first_segment = flights[0]
    # Samples of other classes lack these attributes, so they are read by name, with a default.
    provenance: Mapping[str, Any] = getattr(first_segment, "provenance", {})
    scale = provenance.get("scale", {})
    fields: JsonValues = {
        "parameters": dict(provenance.get("parameters", {})),
        "earlier": dict(provenance.get("earlier", {})),
        "input_range": (scale["low"], scale["high"]) if scale else (),
    }
    names = getattr(first_segment, "setpoint_names", ())
    if names and all(getattr(flight, "setpoint_names", ()) == names for flight in flights):
        # A segment with names of setpoints has setpoints as well, though its type here does not declare them.
        setpoints = [getattr(flight, "setpoints") for flight in flights]  # noqa: B009
        fields["setpoints"] = np.concatenate(setpoints)
        fields["setpoint_names"] = names
    return fields
