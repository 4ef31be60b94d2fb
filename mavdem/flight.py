"""A flight as a dataset: uniformly sampled motor outputs (inputs) and measured motion (outputs) of one segment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any
from warnings import warn

import numpy as np
from numpy.typing import ArrayLike

from mavdem.arrays import Array, as_real_array
from mavdem.containers import JsonValues, Names
from mavdem.extras import require_extra
from mavdem.facts import Facts
from mavdem.immutable import freeze
from mavdem.unit_errors import suspected_unit_error

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

MAX_VALUE = 1e100
"""Largest size of any number of a flight, in its unit: differences and squares of larger ones could overflow."""

MAX_STEP_RATIO = 1.5
"""Step between two samples, relative to the median step, beyond which samples are missing between them."""

MAX_GRID_DEVIATION = 1e-3
"""Distance, in sampling steps, that a time stamp of uniform samples may have from the uniform grid; rounding only."""


@dataclass(frozen=True, eq=False)
class Flight:
    """Uniformly sampled inputs and outputs of one segment of flight; immutable. Slicing gives a ``Flight``.

    The shapes have T samples, r inputs, m outputs and q setpoints.

    >>> import numpy as np
    >>> time = np.arange(300) / 100
    >>> flight = mavdem.Flight(time, inputs=np.cos(time), outputs=np.sin(time), output_names=("roll",))
    >>> flight
    <Flight: 300 samples at 100 Hz, input 1 -> roll>
    >>> train, test = flight[:200], flight[200:]
    >>> test.time[0], test.outputs.shape, test.duration
    (np.float64(2.0), (100, 1), 1.0)

    Attributes:
        time: (T,) seconds on the autopilot's boot clock, uniform.
        inputs: (T, r) motor outputs, in the unit of the stream. A (T,) array is one input.
        outputs: (T, m) measured motion: for ``axis="roll"`` the roll angle (rad) and rate (rad/s), for ``axis="yaw"``
            the yaw rate only.
        dt: Sampling step, s. Taken from ``time`` unless given; it must be given for a single sample.
        input_names, output_names, input_units, output_units: One string for each column.
        provenance: Source of the flight and how it was made, as plain JSON values.
        effect_directions: (r,) relative effect of each input on the axis; None if the mixer geometry is not known.
        setpoints: (T, q) setpoints of the controllers' outer loops for the axis: at each sample the latest value, NaN
            where there is none yet. None if the source has no setpoints.
        setpoint_names, setpoint_units: One string for each column of ``setpoints``.
        cautions: Facts that make a model less reliable; their sentences are in a log's ``provenance["cautions"]`` too.

    Raises:
        ValueError: The shape, order or values of an argument are wrong; the message names it.

    A ``UserWarning`` is issued where an angle, its rate or time seem to be in degrees or milliseconds.

    See Also:
        :func:`mavdem.read_flight`: a flight from a log; :meth:`segments`: from arrays with gaps.
    """

    time: Array
    inputs: Array
    outputs: Array
    dt: float
    input_names: Names
    output_names: Names
    input_units: Names
    output_units: Names
    provenance: Mapping[str, Any]
    effect_directions: Array | None
    setpoints: Array | None
    setpoint_names: Names
    setpoint_units: Names
    cautions: Facts

    def __init__(
        self,
        time: ArrayLike,
        inputs: ArrayLike,
        outputs: ArrayLike,
        dt: float | None = None,
        input_names: Names | None = None,
        output_names: Names | None = None,
        input_units: Names | None = None,
        output_units: Names | None = None,
        provenance: Mapping[str, Any] | None = None,
        effect_directions: ArrayLike | None = None,
        setpoints: ArrayLike | None = None,
        setpoint_names: Names | None = None,
        setpoint_units: Names | None = None,
        cautions: Facts = (),
    ) -> None:
        """Checks the arguments, which the class describes, and keeps read-only copies of them.

        Args:
            time: (T,) s; uniform, from the first to the last sample.
            inputs: (T, r) motor outputs, or (T,) for one.
            outputs: (T, m) measured motion, or (T,) for one column.
            dt: Sampling step, s; the mean step of ``time`` unless given.
            input_names: r names; "input 1" and so on unless given.
            output_names: m names; "output 1" and so on unless given.
            input_units: r units; empty unless given.
            output_units: m units; empty unless given.
            provenance: Source of the flight, as plain JSON values by name.
            effect_directions: (r,) relative effect of each input on the axis.
            setpoints: (T, q), or (T,) for one; NaN where there is none yet.
            setpoint_names: q names.
            setpoint_units: q units.
            cautions: Facts that make a model less reliable.

        Raises:
            ValueError: The shape, order or values of an argument are wrong; the message names it.
        """
        if not isinstance(provenance, Mapping | None):
            raise ValueError(f"provenance must be values by name, not {provenance!r}")
        time = _checked_time(time)
        inputs = _checked_table(inputs, "inputs", len(time))
        outputs = _checked_table(outputs, "outputs", len(time))
        directions = _checked_directions(effect_directions, inputs)
        # Names and units of no setpoints are checked against a table without columns.
        setpoint_table = np.empty((len(time), 0))
        if setpoints is not None:
            setpoint_table = _checked_table(setpoints, "setpoints", len(time), allow_nan=True)
        fields = {
            "time": time,
            "inputs": inputs,
            "outputs": outputs,
            "dt": _uniform_step(time, dt),
            "input_names": _checked_labels(input_names, "input_names", inputs, "input"),
            "output_names": _checked_labels(output_names, "output_names", outputs, "output"),
            "input_units": _checked_labels(input_units, "input_units", inputs),
            "output_units": _checked_labels(output_units, "output_units", outputs),
            "provenance": freeze(dict(provenance or {})),
            "effect_directions": directions,
            "setpoints": None if setpoints is None else setpoint_table,
            "setpoint_names": _checked_labels(
                setpoint_names, "setpoint_names", setpoint_table, "setpoint"
            ),
            "setpoint_units": _checked_labels(setpoint_units, "setpoint_units", setpoint_table),
            "cautions": cautions,
        }
        # A frozen dataclass refuses plain assignment, also in its own constructor.
        for name, value in fields.items():
            object.__setattr__(self, name, value)
        # The units of a flight from a log, which has a provenance, are the units of its messages.
        unit_error = None if self.provenance else suspected_unit_error(outputs, self.dt)
        if unit_error is not None:
            warn(str(unit_error), stacklevel=2)

    @classmethod
    def segments(
        cls,
        time: ArrayLike,
        inputs: ArrayLike,
        outputs: ArrayLike,
        dt: float | None = None,
        **labels: Any,
    ) -> tuple[Flight, ...]:
        """Cuts arrays with gaps into one ``Flight`` for each segment between them, all with the same ``dt``.

        ``mavdem.learn`` takes the segments together.

        >>> import numpy as np
        >>> time = np.concatenate([np.arange(100), np.arange(150, 300)]) / 100
        >>> [len(flight) for flight in mavdem.Flight.segments(time, np.cos(time), np.sin(time))]
        [100, 150]

        Args:
            time: (T,) seconds, increasing; a step of more than ``MAX_STEP_RATIO`` median steps is a gap.
            inputs: (T, r) motor outputs.
            outputs: (T, m) measured motion.
            dt: Sampling step, s; unless given, the mean step without the gaps.
            **labels: Names, units, setpoints and all other arguments of a ``Flight``.

        Returns:
            The segments in order, without segments of a single sample.

        Raises:
            ValueError: As for a ``Flight``.

        See Also:
            :func:`mavdem.read_segments`: the segments of a log.
        """
        stamps = _checked_time(time)
        steps = np.diff(stamps)
        if not (len(steps) and (steps > 0).all()):
            raise ValueError(
                "time must increase from sample to sample, and there must be two at least"
            )
        # The median step is hardly changed by gaps, which are few; their lengths would change the mean.
        is_gap = steps > MAX_STEP_RATIO * np.median(steps)
        if dt is None:
            dt = float(steps[~is_gap].mean())
        # Index of the first sample after each gap.
        cuts = np.flatnonzero(is_gap) + 1

        tables = {"inputs": inputs, "outputs": outputs, "setpoints": labels.pop("setpoints", None)}
        parts_by_name: dict[str, list[Array]] = {}
        for name, values in tables.items():
            if values is not None:
                # Each Flight below checks for itself whether NaN is allowed in its table.
                table = _checked_table(values, name, len(stamps), allow_nan=True)
                parts_by_name[name] = np.split(table, cuts)

        segments = []
        for number, segment_time in enumerate(np.split(stamps, cuts)):
            # A single sample has no step, and nothing can be learned from it.
            if len(segment_time) > 1:
                arrays: JsonValues = {name: parts[number] for name, parts in parts_by_name.items()}
                segments.append(cls(segment_time, **arrays, dt=dt, **labels))
        return tuple(segments)

    def __len__(self) -> int:
        """The number of samples, T."""
        return len(self.time)

    def __getitem__(self, part: slice) -> Flight:
        """Returns a part of the flight, which keeps its ``dt``, names, units and provenance.

        Args:
            part: Samples of the part, ``first:stop``; the step must be 1.

        Raises:
            TypeError: The index is no slice.
            ValueError: The part has no samples, or the step is not 1.
        """
        if not isinstance(part, slice):
            raise TypeError(
                "a Flight is cut with a slice, flight[a:b]; its samples are in time, inputs and outputs"
            )
        if part.step not in (None, 1) or not len(self.time[part]):
            raise ValueError(f"{part} of {len(self)} samples is empty, or its step is not 1")
        # The part is not validated again: part of a uniform flight is uniform, and has the exact dt of the flight.
        flight = copy(self)
        for name in ("time", "inputs", "outputs", "setpoints"):
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(flight, name, values[part])
        return flight

    def to_pandas(self) -> DataFrame:
        """Returns a ``pandas.DataFrame`` with a row for each sample, indexed by time in s.

        Its columns carry their units as in ``flight.csv``.

        Raises:
            ImportError: The package ``pandas`` is not installed.
        """
        require_extra("pandas", "Flight.to_pandas()")
        from mavdem.export.tables import to_pandas

        return to_pandas(self)

    def to_xarray(self) -> Dataset:
        """Returns an ``xarray.Dataset`` of inputs and outputs, indexed by time in s and by name, with their units.

        Raises:
            ImportError: The package ``xarray`` is not installed.
        """
        require_extra("xarray", "Flight.to_xarray()")
        from mavdem.export.tables import to_xarray

        return to_xarray(self)

    def _repr_html_(self) -> str:
        """The flight as Jupyter notebooks show it: mean, deviation and range of each signal in a table."""
        from mavdem.report.pages.page import flight_html

        return flight_html(self)

    def __repr__(self) -> str:
        """One line with the number of samples, their rate, the names of the signals, and the source."""
        names = f"{', '.join(self.input_names)} -> {', '.join(self.output_names)}"
        source = self.provenance.get("source")
        origin = f" from {source}" if source else ""
        return f"<Flight: {len(self)} samples at {1 / self.dt:.6g} Hz, {names}{origin}>"

    @property
    def duration(self) -> float:
        """Time from the first sample to one sampling step after the last, s."""
        return len(self) * self.dt


Flights = Sequence[Flight]
"""Segments of a flight, or flights of one vehicle."""


def boot_number(flight: Flight) -> int:
    """Returns the number of the autopilot's boot on whose clock a flight from a log has its times.

    An autopilot that restarts in a log begins a new clock, so that times of different boots cannot be compared.
    """
    return int(flight.provenance["segment"]["boot"])


def _checked_time(values: ArrayLike) -> Array:
    """Copies a caller's time stamps, s, to a read-only array (T,).

    Whether they are uniform is checked later (``_uniform_step``): arrays with gaps are cut first.

    Args:
        values: The time stamps, s.

    Returns:
        The time stamps (T,), s.

    Raises:
        ValueError: There are none, they have another shape, or one is not finite.
    """
    time = _read_only_copy(values, "time")
    if time.ndim != 1 or not len(time):
        raise ValueError(f"time must be a non-empty array of shape (T,), not {time.shape}")
    return time


def _checked_table(values: ArrayLike, name: str, length: int, *, allow_nan: bool = False) -> Array:
    """Returns samples as a read-only table.

    Args:
        values: Samples, (length, k), or (length,) for a single column.
        name: Name of the argument, for the message of an error.
        length: Number of samples that the table must have, T.
        allow_nan: Whether NaN may stand for a missing value.

    Returns:
        The table, (length, k).

    Raises:
        ValueError: The shape does not fit, or a value is not finite or too large.
    """
    array = _read_only_copy(values, name, allow_nan=allow_nan)
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or len(array) != length:
        raise ValueError(
            f"{name} must have shape ({length}, columns) to match time, not {array.shape}"
        )
    return array


def _checked_directions(values: ArrayLike | None, inputs: Array) -> Array | None:
    """Copies a caller's effect directions to a read-only array.

    Args:
        values: (r,) relative effect of each input on the axis; None if the mixer geometry is not known.
        inputs: (T, r) the inputs that they belong to.

    Returns:
        The directions (r,); None for None.

    Raises:
        ValueError: There is not one number for each input.
    """
    if values is None:
        return None
    directions = _read_only_copy(values, "effect_directions")
    if directions.shape != inputs.shape[1:]:
        raise ValueError(
            f"effect_directions must have shape {inputs.shape[1:]}, not {directions.shape}"
        )
    return directions


def _read_only_copy(values: ArrayLike, name: str, *, allow_nan: bool = False) -> Array:
    """Copies numbers of a caller to a read-only array, so that the caller cannot change the flight later.

    Args:
        values: Numbers of any shape.
        name: Name of the argument, for the message of an error.
        allow_nan: Whether NaN may stand for a missing value.

    Returns:
        The array.

    Raises:
        ValueError: A value is no real number, not finite or larger than ``MAX_VALUE``.
    """
    array = as_real_array(values, name)
    is_usable = abs(array) <= MAX_VALUE
    if allow_nan:
        is_usable |= np.isnan(array)
    if not is_usable.all():
        raise ValueError(
            f"{name} must be finite and at most {MAX_VALUE:g}; {(~is_usable).sum()} values are not"
        )
    array.setflags(write=False)
    return array


def _uniform_step(time: Array, dt: float | None) -> float:
    """Returns the sampling step of uniform time stamps.

    Args:
        time: Time stamps, (T,), s.
        dt: Sampling step, s, where the caller gives it; None for the mean step of the stamps.

    Returns:
        The sampling step, s.

    Raises:
        ValueError: The step is not positive, or a stamp is farther from a uniform grid than ``MAX_GRID_DEVIATION``.
    """
    if dt is None:
        steps = len(time) - 1
        if not steps:
            raise ValueError("dt must be given for a flight of one sample")
        # Each stamp is divided before the difference is taken, since the difference of huge stamps could overflow.
        dt = float(time[-1] / steps - time[0] / steps)
        if not dt > 0:
            raise ValueError(f"time must increase: its mean step is {dt} s")
    elif not (isinstance(dt, Real) and 0 < dt < np.inf):
        raise ValueError(f"dt must be positive seconds, not {dt!r}")
    # The offset of the grid is free: with the best offset the largest deviation is half the range of the deviations
    # from a grid that begins at 0.
    grid_deviation = np.ptp(time - dt * np.arange(len(time))) / 2 / dt
    if grid_deviation > MAX_GRID_DEVIATION:
        raise ValueError(
            f"time must be uniform: a stamp lies {grid_deviation:.3g} steps off a grid of {dt:.6g} s"
        )
    return float(dt)


def _checked_labels(labels: Names | None, name: str, table: Array, prefix: str = "") -> Names:
    """Returns one label, a name or a unit, for each column of a table.

    Args:
        labels: The labels, where the caller gives them.
        name: Name of the argument, for the message of an error.
        table: The table that is labelled, (T, k).
        prefix: Beginning of the default labels, which are numbered from 1; empty for empty labels.

    Returns:
        k labels.

    Raises:
        ValueError: The labels are no strings, or not one for each column.
    """
    columns = table.shape[1]
    if labels is None:
        if not prefix:
            return ("",) * columns
        return tuple(f"{prefix} {number}" for number in range(1, columns + 1))
    is_sequence = isinstance(labels, list | tuple)
    are_strings = is_sequence and all(type(label) is str for label in labels)
    if not are_strings or len(labels) != columns:
        raise ValueError(
            f"{name} must be strings in a tuple, one for each of the {columns} columns, not {labels!r}"
        )
    return tuple(labels)
