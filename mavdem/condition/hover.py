"""Trim: how hard each motor works in settled flight, how much it has left, and how the vehicle leans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment.align import settled_segments, within
from mavdem.alignment.quality import FULL_THROTTLE, IDLE_THROTTLE
from mavdem.alignment.read import choose_vehicle
from mavdem.alignment.signals import Signals
from mavdem.alignment.verdict import verdict_of
from mavdem.errors import NotLearnable
from mavdem.flight import Flight
from mavdem.ingest import Component, Log, read_log
from mavdem.ingest.motors import MULTIROTORS, OutputScale

HIGHEST_PERCENTILE = 99.0  # What stands for the highest output: the very highest is a spike


@dataclass(frozen=True)
class HoverFigures:
    """Figures of each motor, a number each in the order of ``motors``, over all settled flight.

    Attributes:
        motors: their names.
        unit: of ``trim``, as the source has it; empty for shares.
        seconds: how much settled flight there was.
        trim: mean output, in ``unit``.
        trim_of_range: the same as a share of the range, 0 at no and 1 at full throttle.
        trim_share: ``trim_of_range`` over its mean of all motors: 1 where all work alike.
        headroom: 1 less the 99th percentile of the output as a share of the range: what is left for gusts.
        at_upper_limit: share of the time within 1 % of full throttle.
        at_lower_limit: share of the time at 15 % of the range or less, the idle in flight of ArduPilot by default.
        roll, pitch: mean angles, degrees: the steady lean, against wind or an offset centre of mass. None where not
            known.
    """

    motors: tuple[str, ...]
    unit: str
    seconds: float
    trim: tuple[float, ...]
    trim_of_range: tuple[float, ...]
    trim_share: tuple[float, ...]
    headroom: tuple[float, ...]
    at_upper_limit: tuple[float, ...]
    at_lower_limit: tuple[float, ...]
    roll: float | None
    pitch: float | None

    @property
    def imbalance(self) -> tuple[float, ...]:
        """How much more each motor works than the mean of all, %: 100 (``trim_share`` - 1)."""
        return tuple(100 * (share - 1) for share in self.trim_share)

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values, ``imbalance`` too."""
        values = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}
        return values | {"imbalance": list(self.imbalance)}


def hover(path: str | bytes | PathLike[str], vehicle: str | None = None) -> HoverFigures:
    """Returns the figures of a log's settled flight, of the motors' own messages, however slowly they come.

    >>> figures = mavdem.hover("flight.tlog")
    >>> figures.motors[0], figures.unit, len(figures.headroom)
    ('motor 1 (front right)', 'µs', 4)

    Args:
        path: a log that ``mavdem.ingest.read_log`` reads.
        vehicle: "system" or "system:component", where the log holds several.

    Raises:
        Unreadable: the log cannot be read.
        NotLearnable: it holds no vehicle, or several and none was chosen, or no settled flight with motor outputs.

    See Also:
        :func:`mavdem.hover_figures`: the same of flights; :func:`mavdem.read_flight`.
    """
    return hover_of_log(read_log(path), vehicle)


def hover_of_log(log: Log, vehicle: str | None = None) -> HoverFigures:
    """Returns the figures of a ``vehicle`` in a ``log``, as :func:`hover` gives them."""
    return hover_of(Signals(choose_vehicle(log.vehicles, vehicle), inputs="motors"), log.components)


def hover_of(signals: Signals, components: Sequence[Component] = ()) -> HoverFigures:
    """Returns the figures of ``signals`` with the motors as inputs, as :func:`hover` gives them."""
    segments = settled_segments(signals)
    motors = signals.motors
    if not segments or motors is None or signals.telemetry.vehicle not in (*MULTIROTORS, "UNKNOWN"):
        verdict = verdict_of(signals, components)
        raise NotLearnable(verdict.reason, verdict.remedy)
    rows = within(motors, *segments)
    tilts = zip(("roll", "pitch"), signals.tilts, strict=True)
    lean = {axis: float(np.degrees(tilt.angle[within(tilt, *segments)].mean())) for axis, tilt in tilts}
    seconds = sum(segment.duration for segment in segments)
    return _figures(motors.layout.names, motors.scale, seconds, motors.outputs[rows], lean)


def hover_figures(flights: Sequence[Flight], scale: OutputScale | None = None) -> HoverFigures:
    """Returns the figures of flights with the same motors as inputs, one at least.

    The lean is that of the angles among their outputs: flights of roll and of pitch give both.

    Args:
        flights: as ``mavdem.read_segments`` gives them, for one axis or for several.
        scale: the range of the outputs; that in the flights' ``provenance`` unless given.

    Raises:
        ValueError: there are no flights, their inputs differ or are the controller's demand, or have no known range.
        NotLearnable: the motors never ran.
    """
    if not flights:
        raise ValueError("flights must hold at least one flight")
    names = flights[0].input_names
    if any(flight.input_names != names for flight in flights):
        raise ValueError("flights must have the same inputs")
    if scale is None:
        known = flights[0].provenance.get("scale")
        if not known:
            raise ValueError("the range of the inputs is not known: give the scale")
        scale = OutputScale(**known)
    if scale.name == "demand":
        raise ValueError("the inputs are the controller's demand: read the flights with inputs='motors'")
    # The motors of another axis are the same.
    counted = [flight for flight in flights if flight.output_names == flights[0].output_names]
    angles: dict[str, list[NDArray[np.float64]]] = {}
    for flight in flights:
        for name, column in zip(flight.output_names, flight.outputs.T, strict=True):
            angles.setdefault(name, []).append(column)
    lean = {axis: float(np.degrees(np.concatenate(columns).mean())) for axis, columns in angles.items()}
    seconds = sum(flight.duration for flight in counted)
    return _figures(names, scale, seconds, np.concatenate([flight.inputs for flight in counted]), lean)


def _figures(
    names: tuple[str, ...],
    scale: OutputScale,
    seconds: float,
    outputs: NDArray[np.float64],
    lean: Mapping[str, float],
) -> HoverFigures:
    """Those of ``outputs`` (N, r) and the mean angles ``lean``, degrees."""
    shares = scale.fraction(outputs)
    trims = shares.mean(axis=0)
    if not trims.mean() > 0:
        raise NotLearnable("The motors are off in all of the settled flight.", "Check what wrote the log.")

    def each(values: NDArray[Any]) -> tuple[float, ...]:
        return tuple(float(value) for value in values)

    return HoverFigures(
        motors=names,
        unit=scale.unit,
        seconds=float(seconds),
        trim=each(outputs.mean(axis=0)),
        trim_of_range=each(trims),
        trim_share=each(trims / trims.mean()),
        headroom=each(1 - np.percentile(shares, HIGHEST_PERCENTILE, axis=0)),
        at_upper_limit=each((shares >= FULL_THROTTLE).mean(axis=0)),
        at_lower_limit=each((shares <= IDLE_THROTTLE).mean(axis=0)),
        roll=lean.get("roll"),
        pitch=lean.get("pitch"),
    )
