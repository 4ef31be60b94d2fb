"""Rows of a live flight: angle, body rate and motor outputs at one time, and the format that says what they are."""

from dataclasses import dataclass
from typing import NamedTuple

from mavdem.arrays import Array
from mavdem.containers import Names, Numbers
from mavdem.ingest.motors import MotorGeometry
from mavdem.ingest.output_scale import OutputScale


class AlignedRow(NamedTuple):
    """One point of the uniform grid, equal to a row of the ``Flight`` that is read from a log of the same messages."""

    time: float
    """Time, s of the boot clock."""

    inputs: Array
    """(r,) Motor outputs in the unit of the stream."""

    outputs: Array
    """(2,) Angle, rad, and body rate, rad/s."""

    segment: int
    """Number of the segment, from 0 on; rows of one segment are one step apart."""

    is_settled: bool
    """Whether the vehicle is in settled flight, as far as is known by now."""

    is_free_flight: bool
    """Whether nothing holds the vehicle: it is in settled flight, or climbs after take-off."""


@dataclass(frozen=True, eq=False)
class RowFormat:
    """What the rows of a segment are made of, like the provenance of a ``Flight``."""

    boot: int
    """Number of the vehicle's boot."""

    dt: float
    """Step between rows, s."""

    attitude_message: str
    """Name of the attitude message."""

    motor_message: str
    """Name of the message of motor outputs."""

    geometry: MotorGeometry
    """Channels, names and positions of the motors."""

    scale: OutputScale
    """Unit and range of the motor outputs."""

    rates: Numbers
    """Rates of attitude and motors by which the step was decided, Hz."""

    grid_start: float
    """First point of the grid, s of the boot clock; the first row may be a few seconds later."""

    @property
    def input_units(self) -> Names:
        """The unit of each input."""
        return (self.scale.unit,) * len(self.geometry.names)


class FormattedRow(NamedTuple):
    """A row together with its format."""

    row_format: RowFormat
    """The format."""

    row: AlignedRow
    """The row."""
