"""Flight: the aligned dataset a model is learned from."""

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

MAX_VALUE = 1e100  # of any number of a flight: differences and squares of larger ones overflow


@dataclass(frozen=True, eq=False)
class Flight:
    """Uniformly sampled inputs and outputs of one segment of flight; immutable. Slicing gives a ``Flight``.

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
        outputs: (T, m) what the vehicle did: for ``axis="roll"`` the roll angle (rad) and rate (rad/s), for
            ``axis="yaw"`` the yaw rate only.
        dt: sampling step, s. Taken from ``time`` unless given; it must be given for a single sample.
        input_names, output_names, input_units, output_units: one string a column.
        provenance: where it came from and how it was made, as plain JSON values.
        effect_directions: (r,) relative effect of each input on the axis, where the mixer geometry is known; else None.
        setpoints: (T, q) what the controllers' outer loops asked of the axis: at each sample the
            last value until then, NaN where there is none. None where the source has no setpoints.
        setpoint_names, setpoint_units: one string a column of ``setpoints``.
        cautions: what makes a model less reliable; their sentences are in a log's ``provenance["cautions"]`` too.

    Raises:
        ValueError: names the argument whose shape, order or values are wrong.

    A ``UserWarning`` says where an angle, its rate or time seem to be in degrees or milliseconds.

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
        if not isinstance(provenance, Mapping | None):
            raise ValueError(f"provenance must be values by name, not {provenance!r}")
        time = _stamps(time)
        inputs = _table(inputs, "inputs", len(time))
        outputs = _table(outputs, "outputs", len(time))
        directions = (
            None if effect_directions is None else _frozen(effect_directions, "effect_directions")
        )
        if directions is not None and directions.shape != inputs.shape[1:]:
            raise ValueError(
                f"effect_directions must have shape {inputs.shape[1:]}, not {directions.shape}"
            )
        none = np.empty((len(time), 0))
        asked = (
            none if setpoints is None else _table(setpoints, "setpoints", len(time), missing=True)
        )
        fields = {
            "time": time,
            "inputs": inputs,
            "outputs": outputs,
            "dt": _uniform_step(time, dt),
            "input_names": _labels(input_names, "input_names", inputs, "input"),
            "output_names": _labels(output_names, "output_names", outputs, "output"),
            "input_units": _labels(input_units, "input_units", inputs),
            "output_units": _labels(output_units, "output_units", outputs),
            "provenance": freeze(dict(provenance or {})),
            "effect_directions": directions,
            "setpoints": None if setpoints is None else asked,
            "setpoint_names": _labels(setpoint_names, "setpoint_names", asked, "setpoint"),
            "setpoint_units": _labels(setpoint_units, "setpoint_units", asked),
            "cautions": cautions,
        }
        for name, value in fields.items():
            object.__setattr__(self, name, value)
        # of a log, units are known
        if not self.provenance and (slip := suspected_unit_error(outputs, self.dt)):
            warn(str(slip), stacklevel=2)

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

        ``mavdem.learn`` takes them together.

        >>> import numpy as np
        >>> time = np.concatenate([np.arange(100), np.arange(150, 300)]) / 100
        >>> [len(flight) for flight in mavdem.Flight.segments(time, np.cos(time), np.sin(time))]
        [100, 150]

        Args:
            time: (T,) seconds, increasing; a step longer than one and a half usual ones is a gap.
            inputs, outputs: (T, r), (T, m).
            dt: sampling step, s; the mean step without the gaps unless given.
            labels: names, units, setpoints and all else of a ``Flight``.

        Raises:
            ValueError: as for a ``Flight``; segments of a single sample are left out.

        See Also:
            :func:`mavdem.read_segments`: the segments of a log.
        """
        stamps = _stamps(time)
        steps = np.diff(stamps)
        if not (len(steps) and (steps > 0).all()):
            raise ValueError(
                "time must increase from sample to sample, and there must be two at least"
            )
        gaps = steps > 1.5 * np.median(steps)
        if dt is None:
            dt = float(steps[~gaps].mean())
        cuts = np.flatnonzero(gaps) + 1
        tables = {"inputs": inputs, "outputs": outputs, "setpoints": labels.pop("setpoints", None)}
        cut: JsonValues = {
            name: np.split(_table(values, name, len(stamps), True), cuts)
            for name, values in tables.items()
            if values is not None
        }
        return tuple(
            cls(part, **{name: parts[at] for name, parts in cut.items()}, dt=dt, **labels)
            for at, part in enumerate(np.split(stamps, cuts))
            if len(part) > 1
        )

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, part: slice) -> Flight:
        if not isinstance(part, slice):
            raise TypeError(
                "a Flight is cut with a slice, flight[a:b]; its samples are in time, inputs and outputs"
            )
        if part.step not in (None, 1) or not len(self.time[part]):
            raise ValueError(f"{part} of {len(self)} samples is empty, or its step is not 1")
        # Not validated anew: a part of what is uniform is uniform, and keeps the step of the whole.
        cut = copy(self)
        for name in ("time", "inputs", "outputs", "setpoints"):
            if (values := getattr(self, name)) is not None:
                object.__setattr__(cut, name, values[part])
        return cut

    def to_pandas(self) -> DataFrame:
        """Returns a ``pandas.DataFrame``: a row a sample, by time in s; columns with units as in ``flight.csv``.

        Raises:
            ImportError: ``pandas`` is not installed.
        """
        require_extra("pandas", "Flight.to_pandas()")
        from mavdem.export.conversion import to_pandas

        return to_pandas(self)

    def to_xarray(self) -> Dataset:
        """Returns an ``xarray.Dataset``: inputs and outputs by time in s and name, their units beside them.

        Raises:
            ImportError: ``xarray`` is not installed.
        """
        require_extra("xarray", "Flight.to_xarray()")
        from mavdem.export.conversion import to_xarray

        return to_xarray(self)

    def _repr_html_(self) -> str:
        from mavdem.report.page import flight_html

        return flight_html(self)

    def __repr__(self) -> str:
        names = f"{', '.join(self.input_names)} -> {', '.join(self.output_names)}"
        source = self.provenance.get("source")
        origin = f" from {source}" if source else ""
        return f"<Flight: {len(self)} samples at {1 / self.dt:.6g} Hz, {names}{origin}>"

    @property
    def duration(self) -> float:
        """Seconds from the first sample to one step after the last."""
        return len(self) * self.dt


Flights = Sequence[Flight]
"""Segments of a flight, or flights of one vehicle."""


def boot_number(flight: Flight) -> int:
    """Returns the boot of the autopilot on whose clock a flight read from a log has its times."""
    return int(flight.provenance["segment"]["boot"])


def _stamps(values: ArrayLike) -> Array:
    time = _frozen(values, "time")
    if time.ndim != 1 or not len(time):
        raise ValueError(f"time must be a non-empty array of shape (T,), not {time.shape}")
    return time


def _table(values: ArrayLike, name: str, length: int, missing: bool = False) -> Array:
    array = _frozen(values, name, missing)
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or len(array) != length:
        raise ValueError(
            f"{name} must have shape ({length}, columns) to match time, not {array.shape}"
        )
    return array


def _frozen(values: ArrayLike, name: str, missing: bool = False) -> Array:
    """A copy that cannot be written; NaN stands for what is ``missing`` where that may be."""
    array = as_real_array(values, name)
    wrong = ~(abs(array) <= MAX_VALUE) & ~(missing & np.isnan(array))
    if wrong.any():
        raise ValueError(
            f"{name} must be finite and at most {MAX_VALUE:g}; {wrong.sum()} values are not"
        )
    array.setflags(write=False)
    return array


def _uniform_step(time: Array, dt: float | None) -> float:
    if dt is None:
        steps = len(time) - 1
        if not steps:
            raise ValueError("dt must be given for a flight of one sample")
        # Divided first: stamps far apart must not overflow.
        dt = float(time[-1] / steps - time[0] / steps)
        if not dt > 0:
            raise ValueError(f"time must increase: its mean step is {dt} s")
    elif not (isinstance(dt, Real) and 0 < dt < np.inf):
        raise ValueError(f"dt must be positive seconds, not {dt!r}")
    # From the place on the uniform grid that suits all stamps best.
    off_grid = np.ptp(time - dt * np.arange(len(time))) / 2 / dt
    if off_grid > 1e-3:
        raise ValueError(
            f"time must be uniform: a stamp lies {off_grid:.3g} steps off a grid of {dt:.6g} s"
        )
    return float(dt)


def _labels(labels: Names | None, name: str, table: Array, prefix: str = "") -> Names:
    columns = table.shape[1]
    if labels is None:
        return tuple(f"{prefix} {i + 1}" if prefix else "" for i in range(columns))
    are_strings = isinstance(labels, list | tuple) and {str}.issuperset(map(type, labels))
    if not (are_strings and len(labels) == columns):
        raise ValueError(
            f"{name} must be strings in a tuple, one for each of the {columns} columns, not {labels!r}"
        )
    return tuple(labels)
