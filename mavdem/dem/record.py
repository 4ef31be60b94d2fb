"""The training data: uniformly sampled segments with gaps between, across which nothing is computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from reprlib import Repr
from typing import Any, NamedTuple, Protocol, TypeGuard, get_type_hints

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from mavdem.arrays import Array, ArrayPair, Flags, Indices, as_real_array
from mavdem.containers import JsonValues, Names, Numbers
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE
from mavdem.errors import NotLearnable
from mavdem.facts.model import ModelRefusal

# no text for a number, no ``True`` for 1, no infinity and no NaN
STRICT = ConfigDict(strict=True, allow_inf_nan=False)

Segments = list[ArrayPair]  # of inputs and outputs
SHORT = Repr()
SHORT.maxother = SHORT.maxstring = 80


def checked_values(kind: type, values: Mapping[str, Any]) -> JsonValues:
    """Returns values by name, as the fields of ``kind`` are annotated; ``ValueError``: ``<name> must be …, not …``."""
    try:
        return dict(_model(kind).model_validate(values))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = str(first["loc"][0])
        raise ValueError(f"{name} {_requirement(first)}, not {values[name]!r}") from None


@cache
def _model(kind: type) -> type[BaseModel]:
    fields: Any = {
        name: (hint, ...) for name, hint in get_type_hints(kind, include_extras=True).items()
    }
    return create_model("Values", __config__=STRICT, **fields)


def first_problem(error: ValidationError) -> str:
    """Returns the first thing that pydantic found.

    It reads ``<field> must be …, not <value>``, or ``<field> is missing``.
    """
    first = error.errors(include_url=False)[0]
    name = ".".join(map(str, first["loc"]))
    if first["type"].startswith("missing"):
        return f"{name} is missing"
    value = "" if first["type"] == "value_error" else f", not {SHORT.repr(first['input'])}"
    return f"{name} {_requirement(first)}{value}".lstrip()


def _requirement(problem: Mapping[str, Any]) -> str:
    said = problem["msg"].removeprefix("Value error, ")
    return str(said).replace("Input should", "must", 1).replace("Tuple should", "must", 1)


def is_number(value: object) -> TypeGuard[float]:
    """Returns whether it is one real number, of Python's or numpy's; ``True`` is not."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def is_integer(value: object) -> TypeGuard[int]:
    """Returns whether it is one whole number of 64 bits, of Python's or numpy's; ``True`` is not."""
    return (
        isinstance(value, int | np.integer)
        and not isinstance(value, bool)
        and abs(int(value)) < 2**63
    )


MAX_STEPS = 100_000  # ahead: of as many predictions take a fraction of a gigabyte, and seconds
MIN_STEP = 1e-9
MAX_ABS_VALUE = 1e50
"""Seconds between samples, and size of one: beyond, squares and derivatives overflow; of its inverse they underflow."""

# how far the sampling steps of segments may differ, relative to the first: by rounding only
STEP_TOLERANCE = 1e-6

MIN_MOTORS = 3  # inputs, from which on they are taken for a multirotor's motors

LABELS = ("input_names", "output_names", "input_units", "output_units")
"""Of a flight and of a record: one string a column."""


class ChannelStatistics(NamedTuple):
    """Mean, variance and range of each column; (k,) each."""

    mean: Array
    variance: Array
    lowest: Array
    highest: Array

    @classmethod
    def of(cls, samples: Array) -> ChannelStatistics:
        """Returns that of samples (T, k)."""
        return cls(
            samples.mean(axis=0), samples.var(axis=0), samples.min(axis=0), samples.max(axis=0)
        )

    @property
    def moving(self) -> Flags:
        """(k,) which columns vary by more than rounding."""
        size = np.maximum(abs(self.lowest), abs(self.highest))
        return self.highest - self.lowest > np.maximum(ROUNDING_TOLERANCE * size, 1 / MAX_ABS_VALUE)


class UniformSamples(Protocol):
    """What ``learn`` needs of a flight: inputs (T, r), outputs (T, m) and the sampling step, s."""

    @property
    def inputs(self) -> Array: ...  # noqa: D102
    @property
    def outputs(self) -> Array: ...  # noqa: D102
    @property
    def dt(self) -> float: ...  # noqa: D102

    # May have as well, as a ``Flight`` has: ``effect_directions``, ``time``, and names and units of its columns.


TrainingData = UniformSamples | Sequence[UniformSamples]


@dataclass(frozen=True, eq=False)
class Record:
    """Samples of segments, one after the other, physical."""

    inputs: Array  # (T, r)
    outputs: Array  # (T, m)
    dt: float
    lengths: tuple[int, ...]
    # (r,) relative effect of each motor on the axis, where it is known
    effect_directions: Array | None = None
    # (segments,) times of the first samples on the flight's clock, s, if it has one
    begins: Numbers = ()
    input_names: Names = ()
    output_names: Names = ()
    input_units: Names = ()
    output_units: Names = ()
    # of the autopilot's controller, by name
    parameters: Mapping[str, float] = field(default_factory=dict)
    # of the parameters that changed in flight or later
    earlier: Mapping[str, float] = field(default_factory=dict)
    input_range: Numbers = ()  # inputs at no and at full throttle, where they are known
    setpoints: Array | None = None  # (T, q) what was asked of the axis, NaN where there is none
    setpoint_names: Names = ()

    def __post_init__(self) -> None:
        validated_step(self.dt)
        require_finite_and_bounded(self.inputs, "inputs")
        require_finite_and_bounded(self.outputs, "outputs")
        rows = sum(self.lengths)
        shapes = [validated_table.shape for validated_table in (self.inputs, self.outputs)]
        if not rows or any(len(shape) != 2 or shape[0] != rows for shape in shapes):
            raise ValueError(
                f"inputs and outputs must be tables of {rows} rows, the sum of lengths"
            )
        directions = self.effect_directions
        if directions is not None and directions.shape != shapes[0][1:]:
            raise ValueError("effect_directions must have a number for each column of inputs")

    @classmethod
    def from_flights(cls, train: TrainingData) -> Record:
        """Returns that of a flight, or of segments of one sampled at the same rate.

        Raises ``ValueError``, which names what does not fit.
        """
        if isinstance(train, Record):
            return train
        flights = train if isinstance(train, Sequence) else [train]
        if not flights:
            raise ValueError("train must hold at least one segment")
        parts = [_checked(flight) for flight in flights]
        inputs, outputs, steps = zip(*parts, strict=True)
        for name, tables in (("inputs", inputs), ("outputs", outputs)):
            widths = [validated_table.shape[1] for validated_table in tables]
            if len(set(widths)) > 1:
                raise ValueError(f"{name} must have as many columns in every segment, not {widths}")
        if np.ptp(steps) > STEP_TOLERANCE * steps[0]:
            raise ValueError(
                f"dt must be the same in every segment, not between {min(steps)} and {max(steps)} s"
            )
        lengths = tuple(len(validated_table) for validated_table in outputs)
        directions = _directions(flights, inputs[0].shape[1])
        labels: JsonValues = {name: tuple(getattr(flights[0], name, ())) for name in LABELS}
        times: list[Sequence[float]] = [getattr(flight, "time", ()) for flight in flights]
        begins = tuple(float(time[0]) for time in times) if all(map(len, times)) else ()
        labels |= _controlled(flights)
        return cls(
            np.concatenate(inputs),
            np.concatenate(outputs),
            steps[0],
            lengths,
            directions,
            begins,
            **labels,
        )

    def __len__(self) -> int:
        return len(self.outputs)

    @cached_property
    def segment_starts(self) -> Indices:
        """(segments,) the first sample of each."""
        return np.cumsum([0, *self.lengths[:-1]])

    @cached_property
    def channel_statistics(self) -> tuple[ChannelStatistics, ChannelStatistics]:
        """That of the inputs and of the outputs."""
        return ChannelStatistics.of(self.inputs), ChannelStatistics.of(self.outputs)

    def require_varying(self, known_inputs: bool) -> None:
        """Raises ``NotLearnable`` for a constant output, or input if there are ``known_inputs``."""
        inputs, outputs = self.channel_statistics
        for name, constant in (
            ("inputs", ~inputs.moving & known_inputs),
            ("outputs", ~outputs.moving),
        ):
            still = np.flatnonzero(constant)
            if len(still):
                raise NotLearnable(
                    ModelRefusal.CHANNEL_CONSTANT,
                    subject=f"{name} column {still[0]}",
                    others_vary=name == "inputs" and len(still) < len(constant),
                )

    @property
    def segments(self) -> Segments:
        """Inputs and outputs of each segment."""
        cuts = self.segment_starts[1:]
        return list(zip(np.split(self.inputs, cuts), np.split(self.outputs, cuts), strict=True))

    def sample_indices(self, times: Sequence[float]) -> list[int]:
        """Returns the samples at ``times`` on the flight's clock, s, that are inside segments; sorted, each once."""
        segments = list(zip(self.begins, self.segment_starts.tolist(), self.lengths, strict=False))
        steps = [
            (round((time - begin) / self.dt), *rest) for time in times for begin, *rest in segments
        ]
        return sorted({start + step for step, start, length in steps if 0 < step < length})

    @property
    def longest_segment(self) -> int:
        """Samples of the longest segment."""
        return max(self.lengths)

    def validated_inputs(self, inputs: ArrayLike) -> Array:
        """Returns the inputs (H, r) of a forecast of what follows the record, checked; of one input (H,) will do."""
        return validated_table(inputs, "inputs", self.inputs.shape[1])

    def validated_samples(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> ArrayPair:
        """Returns inputs (H, r) and outputs (H, m) that follow the record, checked, as is the number of ``steps``."""
        validated_count(steps)
        ahead = self.validated_inputs(inputs)
        measured = validated_table(outputs, "outputs", self.outputs.shape[1])
        if len(ahead) != len(measured):
            raise ValueError(
                f"inputs and outputs must be of the same samples, not {len(ahead)} and {len(measured)}"
            )
        return ahead, measured

    def window_count(self, window: int) -> int:
        """Returns the number of windows of ``window`` samples inside segments."""
        return sum(max(0, length - window + 1) for length in self.lengths)


def validated_step(dt: object) -> float:
    """Returns a sampling step ``dt``, s, as a ``float``; raises ``ValueError`` for what is none."""
    if not (is_number(dt) and MIN_STEP <= dt <= 1 / MIN_STEP):
        raise ValueError(f"dt must be positive seconds, at least {MIN_STEP:g}, not {dt!r}")
    return float(dt)


def validated_directions(values: ArrayLike, motors: int) -> Array:
    """Returns effect directions (r,) of so many ``motors``; raises ``ValueError`` for what is none."""
    directions = as_real_array(values, "effect_directions")
    if directions.shape != (motors,) or not np.isfinite(directions).all():
        raise ValueError(f"effect_directions must be {motors} finite numbers, not {values!r}")
    return directions


def validated_count(number: int, name: str = "steps", most: int = 1_000_000_000) -> int:
    """Returns ``number`` as an ``int``.

    Raises ``ValueError``, which names it, for what is no whole number from 1 to ``most``.
    """
    if not (is_integer(number) and 1 <= number <= most):
        raise ValueError(f"{name} must be a whole number from 1 to {most:,}, not {number!r}")
    return int(number)


def validated_table(values: ArrayLike, name: str, columns: int) -> Array:
    """Returns samples (H, columns); of one column (H,) will do. Raises ``ValueError`` for others, or not finite."""
    samples = as_real_array(values, name)
    if samples.ndim == 1 and columns == 1:
        samples = samples[:, None]
    if samples.ndim != 2 or samples.shape[1] != columns:
        raise ValueError(f"{name} must have shape (H, {columns}), not {samples.shape}")
    if not np.isfinite(samples).all():
        raise ValueError(f"{name} must be finite")
    return samples


def require_finite_and_bounded(samples: Array, name: str) -> None:
    """Raises ``ValueError`` for samples to learn from that are not finite, or too large to square."""
    if not np.isfinite(samples).all():
        raise ValueError(f"{name} must be finite")
    if abs(samples).max(initial=0.0) > MAX_ABS_VALUE:
        raise ValueError(f"{name} must not be larger than {MAX_ABS_VALUE:g}")


def _directions(flights: Sequence[UniformSamples], motors: int) -> Array | None:
    """(r,) the effect directions of all segments; ``None`` unless each has the same, and not all are zero."""
    given = [getattr(flight, "effect_directions", None) for flight in flights]
    tables = [validated_directions(row, motors) for row in given if row is not None]
    same = (
        len(tables) == len(flights)
        and tables[0].any()
        and all(np.array_equal(validated_table, tables[0]) for validated_table in tables)
    )
    return tables[0] if same else None


def _controlled(flights: Sequence[UniformSamples]) -> JsonValues:
    """The controller's parameters, the range of the inputs, and the setpoints that all segments have."""
    provenance = getattr(flights[0], "provenance", {})
    names = getattr(flights[0], "setpoint_names", ())
    scale = provenance.get("scale", {})
    fields = JsonValues()
    fields |= {name: dict(provenance.get(name, {})) for name in ("parameters", "earlier")}
    fields["input_range"] = (scale["low"], scale["high"]) if scale else ()
    if names and all(getattr(flight, "setpoint_names", ()) == names for flight in flights):
        asked = [getattr(flight, "setpoints") for flight in flights]  # noqa: B009
        fields |= {"setpoints": np.concatenate(asked), "setpoint_names": names}
    return fields


def _checked(train: UniformSamples) -> tuple[Array, Array, float]:
    try:
        inputs = as_real_array(train.inputs, "inputs")
        outputs = as_real_array(train.outputs, "outputs")
        dt = float(as_real_array(train.dt, "dt"))
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
    return inputs, outputs, dt


def cross_validation_folds(lengths: Sequence[int], count: int) -> list[list[tuple[int, int, int]]]:
    """Returns the samples of segments of these ``lengths`` in ``count`` parts of about equal length, none empty.

    A part has pieces of one segment each: its number, and the first sample and the one after the last.
    """
    total = sum(lengths)
    parts = []
    for fold in range(count):
        begin = total * fold // count
        end = total * (fold + 1) // count
        before = 0
        pieces = []
        for number, length in enumerate(lengths):
            first = max(begin - before, 0)
            stop = min(end - before, length)
            if first < stop:
                pieces.append((number, first, stop))
            before += length
        parts.append(pieces)
    return [pieces for pieces in parts if pieces]
