"""Hover: how hard each motor works in settled flight, its headroom, and how the vehicle leans."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Names, Numbers
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.learnability import learnability_of
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.segments import in_segments, settled_segments
from mavdem.dataset.signals import Signals
from mavdem.errors import NotLearnable
from mavdem.facts.learnability import UnusableOutputs
from mavdem.files import AnyPath
from mavdem.ingest import Component, read_log
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.output_scale import OutputScale

MAX_OUTPUT_PERCENTILE = 99.0
"""Percentile of the output that counts as a motor's highest: the very highest sample is a spike."""


@dataclass(frozen=True)
class HoverFigures:
    """Figures of each of k motors over all settled flight; tuples are in the order of ``motors``."""

    motors: Names
    """Names of the motors."""
    unit: str
    """Unit of ``trim``, as in the source; empty for fractions of the range."""
    seconds: float
    """Duration of settled flight, s."""
    trim: Numbers
    """(k,) mean output, in ``unit``."""
    trim_of_range: Numbers
    """(k,) mean output as a fraction of the range, 0 at no and 1 at full throttle."""
    trim_share: Numbers
    """(k,) ``trim_of_range`` over its mean of all motors: 1 where all work equally hard."""
    headroom: Numbers
    """(k,) upper limit less the 99th percentile of the output, as a fraction of the range: what is left for gusts."""
    at_upper_limit: Numbers
    """(k,) fraction of the time within 1 % of the range of the upper limit or, where none shows, of full throttle."""
    at_lower_limit: Numbers
    """(k,) fraction of the time within 1 % of the range of the lower limit, the motor's idle in flight, or below it."""
    roll: float | None
    """Mean roll, degrees: steady lean against wind or an offset centre of mass; None where it is not known."""
    pitch: float | None
    """Mean pitch, degrees, likewise."""

    @property
    def imbalance(self) -> Numbers:
        """(k,) by how much each motor works harder than the mean of all, %: 100 (``trim_share`` - 1)."""
        return tuple(100 * (share - 1) for share in self.trim_share)


def hover(path: AnyPath, vehicle: str | None = None) -> HoverFigures:
    """Computes how hard each motor works in the settled flight of a log; outputs at a low rate are enough.

    >>> figures = mavdem.hover("flight.tlog")
    >>> figures.motors[0], figures.unit, len(figures.headroom)
    ('motor 1 (front right)', 'µs', 4)

    Args:
        path: A log in one of the formats of ``mavdem.ingest.read_log``.
        vehicle: "system" or "system:component", where the log holds several vehicles.

    Returns:
        Output and headroom of each motor, and the mean lean of the vehicle.

    Raises:
        Unreadable: The log cannot be read.
        NotLearnable: The log has no vehicle, has several while ``vehicle`` names none, or has no settled flight with
            motor outputs.

    See Also:
        :func:`mavdem.read_flight`.
    """
    log = read_log(path)
    signals = Signals(choose_vehicle(log.vehicles, vehicle), inputs="motors")
    return hover_of(signals, log.components)


def hover_of(signals: Signals, components: Sequence[Component] = ()) -> HoverFigures:
    """Computes how hard each motor of a vehicle works in settled flight, when the vehicle hovers or moves slowly.

    Args:
        signals: Signals of the vehicle with the motors as model inputs.
        components: All components in the log, for the advice if there is no settled flight.

    Returns:
        Trim, headroom and the fraction of time at the limits of each motor, and the mean lean of the vehicle in roll
        and pitch, degrees.

    Raises:
        NotLearnable: There is no settled flight with motor outputs, the motors never ran, or the vehicle is not a
            multirotor.
    """
    settled_flight = settled_segments(signals)
    motors = signals.motors
    may_be_multirotor = signals.telemetry.vehicle in POSSIBLE_MULTIROTORS
    if not settled_flight or motors is None or not may_be_multirotor:
        raise NotLearnable(learnability_of(signals, components).reason)
    mean_lean = {}
    for axis, tilt in zip(TILT_AXES, signals.tilts, strict=True):
        settled_angles = tilt.angle[in_segments(tilt, *settled_flight)]
        mean_lean[axis] = float(np.degrees(settled_angles.mean()))
    return hover_figures(
        motors.geometry.names,
        motors.scale,
        seconds=sum(segment.duration for segment in settled_flight),
        outputs=motors.outputs[in_segments(motors, *settled_flight)],
        lean=mean_lean,
    )


def hover_figures(
    names: Names,
    scale: OutputScale,
    seconds: float,
    outputs: Array,
    lean: Mapping[str, float],
) -> HoverFigures:
    """Computes trim, headroom and time at the limits of each motor from its outputs, as a rule in settled flight.

    Means and shares are over samples. Outputs are converted to fractions of their range, so that vehicles with PWM (µs)
    and with normalised outputs have comparable figures.

    Args:
        names: Names of the k motors.
        scale: Scale of their outputs.
        seconds: Duration of the flight with these outputs, s.
        outputs: (N, k) outputs in the unit of the scale.
        lean: Mean angle, degrees, by axis, if it is known.

    Returns:
        Figures of the k motors, as fractions of the range.

    Raises:
        NotLearnable: The motors never ran.
    """
    fractions = scale.fraction(outputs)
    mean_fractions = fractions.mean(axis=0)
    # A comparison with NaN is false, so that outputs that are not known do not count as running.
    are_running = mean_fractions.mean() > 0
    if not are_running:
        raise NotLearnable(UnusableOutputs.MOTORS_OFF)
    highest = np.percentile(fractions, MAX_OUTPUT_PERCENTILE, axis=0)
    is_at_upper, is_at_lower = samples_at_limits(fractions, scale)
    return HoverFigures(
        motors=names,
        unit=scale.unit,
        seconds=float(seconds),
        trim=tuple(outputs.mean(axis=0).tolist()),
        trim_of_range=tuple(mean_fractions.tolist()),
        trim_share=tuple((mean_fractions / mean_fractions.mean()).tolist()),
        headroom=tuple(np.maximum(scale.upper_limit - highest, 0.0).tolist()),
        at_upper_limit=tuple(is_at_upper.mean(axis=0).tolist()),
        at_lower_limit=tuple(is_at_lower.mean(axis=0).tolist()),
        roll=lean.get("roll"),
        pitch=lean.get("pitch"),
    )
