"""Condition: what a log says of a vehicle at any rate: balance, limits, lean, vibration and battery."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment import phases
from mavdem.alignment.drive import AXES, TILT_AXES
from mavdem.alignment.intervals import both, total
from mavdem.alignment.signals import Signals
from mavdem.alignment.trim import HoverFigures, hover_of
from mavdem.condition.battery import BatteryFigures, battery_of
from mavdem.condition.mean_interval import mean_interval
from mavdem.condition.periods import Periods, during, log_span, seconds_of, settled_flight
from mavdem.condition.vibration import VibrationFigures, vibration_of
from mavdem.errors import NotLearnable


@dataclass(frozen=True)
class Steady:
    """A quantity over settled flight.

    Attributes:
        mean: its mean.
        interval: half width of the mean's 90 % interval, by the slow part of the series; None where too short to tell.
        sd: its standard deviation.
    """

    mean: float
    interval: float | None
    sd: float


@dataclass(frozen=True)
class Condition:
    """Figures that need no fast stream: means, spreads and limits. They hold for any rate from 1 Hz.

    All of them are of settled flight, but for the first two, and the battery where there was none. None where a figure
    was not recorded.

    Attributes:
        duration: of the log, s, over all boots.
        armed: of it armed, s; None where the log does not say.
        settled: of it in settled flight, s.
        hover: what each motor does, how hard it works, and what it has left.
        share_interval: half widths of the 90 % intervals of ``hover.trim_share``; within this flight, not between
            flights.
        command: for each axis known, the motors' combination that turns it, as a share of their range: what balances a
            shifted load, steady wind or a weak motor. Positive: to the right, nose up, nose to the right.
        lean: roll and pitch, rad.
        tilt_mean, tilt_sd, tilt_max: of the angle from level, rad.
        vibration: level and clips.
        battery: voltage and current.
    """

    duration: float
    armed: float | None
    settled: float
    hover: HoverFigures | None
    share_interval: tuple[float | None, ...]
    command: dict[str, Steady]
    lean: dict[str, Steady]
    tilt_mean: float | None
    tilt_sd: float | None
    tilt_max: float | None
    vibration: VibrationFigures | None
    battery: BatteryFigures | None

    @property
    def collective(self) -> float | None:
        """Mean of all motors, as a share of their range."""
        return None if self.hover is None else float(np.mean(self.hover.trim_of_range))

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values; angles in rad, but for those of ``hover``."""
        return {
            **asdict(self),
            "hover": None if self.hover is None else self.hover.as_dict(),
            "share_interval": list(self.share_interval),
            "vibration": None if self.vibration is None else self.vibration._asdict(),
            "collective": self.collective,
        }


def condition_of(signals: Signals) -> Condition:
    """The condition of the vehicle of ``signals``, whatever they are for: it takes the motors' own messages."""
    signals = Signals(signals.telemetry, inputs="motors") if signals.inputs != "motors" else signals
    span, settled = log_span(signals), settled_flight(signals)
    try:
        hover = hover_of(signals)
    except NotLearnable:
        hover = None
    intervals, command = ((), {}) if hover is None else _balance(signals, settled)
    armed = sum(total(both(recorded, phases.armed(signals, boot))) for boot, recorded in span.items())
    lean, tilt = _leaning(signals, settled)
    return Condition(
        duration=seconds_of(span),
        armed=None if signals.armed is None else float(armed),
        settled=seconds_of(settled),
        hover=hover,
        share_interval=intervals,
        command=command,
        lean=lean,
        tilt_mean=float(tilt.mean()) if len(tilt) else None,
        tilt_sd=float(tilt.std()) if len(tilt) else None,
        tilt_max=float(tilt.max()) if len(tilt) else None,
        vibration=vibration_of(signals, settled),
        battery=battery_of(signals, settled or span),
    )


def _balance(signals: Signals, settled: Periods) -> tuple[tuple[float | None, ...], dict[str, Steady]]:
    """Half widths of the motors' shares, and the steady command of each axis."""
    motors, seconds = signals.motors, seconds_of(settled)
    assert motors is not None
    shares = motors.scale.fraction(motors.outputs[during(settled, motors.time, motors.boot)])
    level = shares.mean(axis=1, keepdims=True)
    # A ratio of means: its error is the mean of these.
    balance = (shares - level * (shares.mean(axis=0) / level.mean())) / level.mean()
    intervals = mean_interval(balance, seconds).half_width
    weights = {axis: effect for axis in AXES if (effect := motors.layout.effect(axis)) is not None}
    return (
        tuple(_known(half) for half in intervals),
        {axis: _steady(shares @ effect, seconds) for axis, effect in weights.items()},
    )


def _leaning(signals: Signals, settled: Periods) -> tuple[dict[str, Steady], NDArray[np.float64]]:
    """Roll and pitch, and the angle from level (N,), rad."""
    if len(signals.tilts) < len(TILT_AXES):
        return {}, np.zeros(0)
    angles = [tilt.angle[during(settled, tilt.time, tilt.boot)] for tilt in signals.tilts]
    if not all(map(len, angles)):
        return {}, np.zeros(0)
    seconds = seconds_of(settled)
    lean = {axis: _steady(angle, seconds) for axis, angle in zip(TILT_AXES, angles, strict=True)}
    # Both come with the same messages, so they differ in length only where a row of one was left out.
    roll, pitch = (angle[: min(map(len, angles))] for angle in angles)
    return lean, np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1, 1))


def _steady(values: NDArray[np.float64], seconds: float) -> Steady:
    found = mean_interval(values[:, None], seconds)
    return Steady(float(found.mean[0]), _known(found.half_width[0]), float(values.std()))


def _known(half_width: float) -> float | None:
    return float(half_width) if np.isfinite(half_width) else None
