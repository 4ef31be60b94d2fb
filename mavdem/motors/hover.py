"""Hover: how hard each motor works in settled flight, how much it has left, and how the vehicle leans."""

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
from mavdem.facts.learnability import MotorObstacle
from mavdem.files import AnyPath
from mavdem.ingest import Component, read_log
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.output_scale import OutputScale


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
        headroom: the upper stop less the 99th percentile of the output, as shares of the range: what is left for gusts.
        at_upper_limit: share of the time within 1 % of the range of the upper stop, where the autopilot or the outputs
            show one; else of full throttle.
        at_lower_limit: share of the time at 15 % of the range or less, the idle in flight of ArduPilot by default.
        roll, pitch: mean angles, degrees: the steady lean, against wind or an offset centre of mass. None where not
            known.
    """

    motors: Names
    unit: str
    seconds: float
    trim: Numbers
    trim_of_range: Numbers
    trim_share: Numbers
    headroom: Numbers
    at_upper_limit: Numbers
    at_lower_limit: Numbers
    roll: float | None
    pitch: float | None

    @property
    def imbalance(self) -> Numbers:
        """How much more each motor works than the mean of all, %: 100 (``trim_share`` - 1)."""
        return tuple(100 * (share - 1) for share in self.trim_share)


def hover(path: AnyPath, vehicle: str | None = None) -> HoverFigures:
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
        :func:`mavdem.read_flight`.
    """
    log = read_log(path)
    return hover_of(Signals(choose_vehicle(log.vehicles, vehicle), inputs="motors"), log.components)


def hover_of(signals: Signals, components: Sequence[Component] = ()) -> HoverFigures:
    """Returns the figures of ``signals`` with the motors as inputs, as :func:`hover` gives them."""
    segments = settled_segments(signals)
    motors = signals.motors
    if not segments or motors is None or signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        learnability = learnability_of(signals, components)
        raise NotLearnable(learnability.reason)
    rows = in_segments(motors, *segments)
    tilts = zip(TILT_AXES, signals.tilts, strict=True)
    lean = {
        axis: float(np.degrees(tilt.angle[in_segments(tilt, *segments)].mean()))
        for axis, tilt in tilts
    }
    seconds = sum(segment.duration for segment in segments)
    return hover_figures(motors.geometry.names, motors.scale, seconds, motors.outputs[rows], lean)


def hover_figures(
    names: Names,
    scale: OutputScale,
    seconds: float,
    outputs: Array,
    lean: Mapping[str, float],
) -> HoverFigures:
    """Returns the figures of motor ``outputs`` (N, k) over so many seconds; ``lean`` is by axis, degrees.

    Raises ``NotLearnable``: the motors never ran.
    """
    shares = scale.fraction(outputs)
    trims = shares.mean(axis=0)
    if not trims.mean() > 0:
        raise NotLearnable(MotorObstacle.MOTORS_OFF)
    upper, lower = samples_at_limits(shares, scale)
    each = {
        "trim": outputs.mean(axis=0),
        "trim_of_range": trims,
        "trim_share": trims / trims.mean(),
        # the very highest is a spike
        "headroom": np.maximum(scale.stop - np.percentile(shares, 99.0, axis=0), 0.0),
        "at_upper_limit": upper.mean(axis=0),
        "at_lower_limit": lower.mean(axis=0),
    }
    figures = {name: tuple(values.tolist()) for name, values in each.items()}
    return HoverFigures(
        names, scale.unit, float(seconds), **figures, roll=lean.get("roll"), pitch=lean.get("pitch")
    )
