"""Messages and samples of a live flight in the form that logs have, so that functions for logs can judge them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.condition import Condition
from mavdem.assessment.evidence import Evidence
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.quality import QualityFigures
from mavdem.dataset.resampling import mean_rate
from mavdem.dataset.segment_learnability import Learnability
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Facts
from mavdem.facts.lights import Unjudged
from mavdem.ingest.telemetry import Telemetry, log_of_vehicles
from mavdem.loops.axis_loops import Loop


@dataclass(frozen=True, eq=False)
class LiveSignals(Signals):
    """Signals of a live flight. The fields below are given, while for a log they are read from its messages."""

    motors: MotorOutputs | None = None
    """Motor outputs."""

    collective: TimeSeries | None = None
    """Mean of the motors as a fraction of their range, 0 to 1."""

    landed_state: TimeSeries | None = None
    """MAV_LANDED_STATE over time."""

    tilts: tuple[Attitude, ...] = ()
    """Roll and pitch."""


class RecentMotion(NamedTuple):
    """Motor outputs and attitude of the last seconds."""

    motors: MotorOutputs
    """The outputs of all motors."""

    tilts: Mapping[str, Attitude]
    """Roll and pitch, by axis."""

    @property
    def rate(self) -> float:
        """Mean rate of the slowest of these streams, Hz; 0 where one has fewer than two samples."""
        return slowest_rate([self.motors.time, *(tilt.time for tilt in self.tilts.values())])


def slowest_rate(streams: Iterable[Array | Sequence[float]]) -> float:
    """Returns the mean rate of the slowest of some streams, Hz; 0 where one has fewer than two samples.

    Args:
        streams: the stamps of each stream, s.
    """
    return min(mean_rate(time) if len(time) > 1 else 0.0 for time in streams)


class FlightMoment(NamedTuple):
    """A moment of a live flight, with what is known of the vehicle then besides its messages."""

    time: float
    """Time on the boot clock, s."""

    vehicle: Telemetry
    """Identity and parameters of the vehicle, without messages."""

    takeoff_time: float
    """When the vehicle left the ground, s of the boot clock; minus infinity where that was not seen."""

    motion: RecentMotion | None
    """Attitude and motor outputs of the last seconds; None if they do not come."""


def attitude_from_samples(
    message: str, time: Array, boot: int, angle: Array, body_rate: Array
) -> Attitude:
    """Returns live samples of one axis as ``Attitude``, the form that logs have, so that the rules for logs judge them.

    ``Attitude`` also counts messages that were not used. Live ones were dropped before, so the counts are 0.

    Args:
        message: name of the MAVLink message of the samples.
        time: (N,) times on the boot clock, s.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        angle: (N,) angle, rad.
        body_rate: (N,) body rate, rad/s; it also serves as the derivative of the angle, which is the same near level
            flight.

    Returns:
        The attitude.
    """
    count = len(time)
    boots = np.full(count, boot)
    return Attitude(
        message,
        time=time,
        boot=boots,
        angle=angle,
        rate=body_rate,
        euler_rate=body_rate,
        sent_count=count,
        unused_count=0,
        impossible_count=0,
    )


@dataclass(frozen=True)
class LiveFindings:
    """Events and control loops of a live vehicle, by which it is judged besides its signals."""

    events: Facts = ()
    """Losses of thrust, or reports of the autopilot."""

    loops: Mapping[str, Loop | Fact] = field(default_factory=dict)
    """The control loops by axis, or why they are not known."""

    ending: Fact | None = None
    """How the flight was lost, after which nothing is measured any more; None if it was not lost."""


def live_evidence(
    signals: Signals, condition: Condition, findings: LiveFindings | None = None
) -> Evidence:
    """Returns the evidence by which a log is judged, filled in with the signals of a live vehicle.

    So the functions that judge logs can judge live vehicles, too. Their arguments also have fields that only a whole
    log can fill in, such as whether a model can be learned from it; these get neutral values.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        condition: duration of the flight so far, s, which counts as armed and airborne time, and figures of the
            vehicle.
        findings: events and control loops; None for none.
    """
    if findings is None:
        findings = LiveFindings()
    # Whether a model can be learned is judged elsewhere in a live session: here it counts as possible.
    learnability = Learnability(
        signals.axis,
        learnable=True,
        reason=Fact(Unjudged.NOT_JUDGED, reason=None),
        figures=QualityFigures(armed=condition.duration, airborne=condition.duration),
    )
    log = log_of_vehicles((signals.telemetry,), frames=0, bytes_skipped=0)
    return Evidence(
        log,
        signals,
        learnability,
        condition,
        events=findings.events,
        ending=findings.ending,
        loops=findings.loops,
    )
