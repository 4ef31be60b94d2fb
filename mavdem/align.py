"""From Telemetry to a Flight: choose a stretch of settled flight and put motors and attitude on one uniform clock."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from mavdem import phases
from mavdem.flight import Flight
from mavdem.ingest import meaning
from mavdem.ingest.meaning import AXES, Attitude, Motors
from mavdem.intervals import Intervals, both, without_gaps
from mavdem.telemetry import Telemetry

GAP = 0.1
"""Longest silence, s, that may be bridged: half a period of the 5 Hz at which roll dynamics still live."""

SHORTEST = 1.0
"""Seconds below which a stretch is not worth listing."""

STAMP = 1e-3
"""Resolution, s, of ``time_boot_ms``: two stamps no further apart may belong to the same moment."""


@dataclass(frozen=True)
class Segment:
    """A stretch of settled flight, in seconds on the clock of one boot, with attitude and motors throughout."""

    boot: int
    start: float
    end: float

    @property
    def duration(self) -> float:
        """Seconds from start to end."""
        return self.end - self.start


def segments(telemetry: Telemetry, axis: str = "roll") -> tuple[Segment, ...]:
    """The stretches of one boot, armed, airborne, settled, upright and without gaps; the longest first.

    Steps longer than ``GAP`` part one stretch from the next. Only a stream too slow to leave a stretch at all is
    allowed steps of three intervals: whether that can be learnt from is the verdict's business.

    Raises:
        ValueError: an axis that is neither "roll" nor "pitch".
    """
    attitude, motors = meaning.attitude(telemetry, axis), meaning.motors(telemetry)
    other = meaning.attitude(telemetry, next(name for name in AXES if name != axis))
    if attitude is None or other is None or motors is None:
        return ()
    found: list[Segment] = []
    for intervals_bridged in (0, 3):
        for boot in np.intersect1d(attitude.boot, motors.boot):
            heard = both(_heard(attitude, boot, intervals_bridged), _heard(motors, boot, intervals_bridged))
            for start, end in both(heard, phases.settled(telemetry, attitude, other, motors, boot)):
                segment = Segment(int(boot), start, end)
                if segment.duration >= SHORTEST and _sampled(attitude, segment) and _sampled(motors, segment):
                    found.append(segment)
        if found:
            break
    return tuple(sorted(found, key=lambda segment: -segment.duration))


def align(telemetry: Telemetry, segment: Segment, axis: str = "roll") -> Flight:
    """The flight of ``segment``, uniform on the boot clock.

    Its inputs are one column a motor, its outputs angle and rate of ``axis``.

    The step is the mean interval of the slower of attitude and motors, to 0.1 ms. The mean, because an autopilot that
    rounds 10 ms to its 4 ms loop alternates 8 and 12 and the median is neither.

    A stream with a sample within ``STAMP`` of every grid point keeps its samples as they are. Otherwise both are read
    off the line between their neighbours. A motor output is held by the ESC, but only until the mixer's next turn, a
    few ms later and long before the next message: the messages sample a signal that goes on changing between them.
    Holding the last message would date every input half an interval late on average, a lag the model would learn; the
    line has none. The line looks one message ahead: an input between two messages knows up to one interval of the
    future.

    Raises:
        ValueError: a segment without samples of attitude or motors, or an unknown axis.
    """
    attitude, motors = meaning.attitude(telemetry, axis), meaning.motors(telemetry)
    if attitude is None or motors is None:
        raise ValueError("the telemetry holds no attitude or no motor outputs to align")
    near, motion = _within(attitude, segment), np.column_stack([attitude.angle, attitude.rate])
    drive = _within(motors, segment)
    if not (_sampled(attitude, segment) and _sampled(motors, segment)):
        raise ValueError(f"the segment from {segment.start:.3f} s holds no attitude or no motor outputs")
    rates = {"attitude": mean_rate(attitude.time[near]), "motors": mean_rate(motors.time[drive])}
    dt = max(round(1 / min(rates.values()), 4), 1e-4)
    time = _grid(attitude.time[near], motors.time[drive], dt)
    outputs, kept_attitude = _sample(time, attitude.time[near], motion[near])
    inputs, kept_motors = _sample(time, motors.time[drive], motors.outputs[drive])
    layout, scale = motors.layout, motors.scale
    return Flight(
        time=time,
        inputs=inputs,
        outputs=outputs,
        dt=dt,
        input_names=layout.names,
        output_names=(axis, f"{axis} rate"),
        input_units=(scale.unit,) * len(layout.names),
        output_units=("rad", "rad/s"),
        provenance={
            "source": telemetry.source,
            "system": telemetry.system,
            "component": telemetry.component,
            "vehicle": telemetry.vehicle,
            "autopilot": telemetry.autopilot,
            "axis": axis,
            "segment": asdict(segment),
            "messages": {"attitude": attitude.message, "motors": motors.message},
            "rates": {name: round(rate, 3) for name, rate in rates.items()},
            "dt": dt,
            "resampling": {
                "attitude": "samples kept" if kept_attitude else "linear",
                "motors": "samples kept" if kept_motors else "linear",
            },
            "motors": {
                "channels": list(layout.channels),
                "positions": [list(position) for position in layout.positions],
                "basis": layout.basis,
                "channels_assumed": layout.channels_assumed,
                "positions_assumed": layout.positions_assumed,
            },
            "scale": asdict(scale),
            "repairs": list(telemetry.repairs),
        },
    )


def mean_rate(time: NDArray[np.float64]) -> float:
    """Samples a second over the whole of ``time`` (N,), N ≥ 2."""
    return float((len(time) - 1) / (time[-1] - time[0]))


def _heard(stream: Attitude | Motors, boot: int, intervals_bridged: int) -> Intervals:
    time = stream.time[stream.boot == boot]
    typical = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    return without_gaps(time, max(GAP, intervals_bridged * typical))


def _within(stream: Attitude | Motors, segment: Segment) -> NDArray[np.bool_]:
    inside = (stream.time >= segment.start - STAMP) & (stream.time <= segment.end + STAMP)
    return np.asarray(inside & (stream.boot == segment.boot))


def _sampled(stream: Attitude | Motors, segment: Segment) -> bool:
    """Whether the stream has the two samples in the segment that a rate takes."""
    return int(np.count_nonzero(_within(stream, segment))) >= 2


def _grid(attitude: NDArray[np.float64], motors: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """Steps of ``dt`` where both streams have samples.

    From an attitude sample when both streams then keep theirs; otherwise from a motor sample: from one message to the
    next motor outputs change more than attitude does, so it is attitude that should be moved.
    """
    first, last = max(attitude[0], motors[0]), min(attitude[-1], motors[-1])
    for stamps in (attitude, motors):
        start = stamps[stamps >= first - STAMP][0]
        grid = np.asarray(start + dt * np.arange(int((last - start) / dt + STAMP) + 1))
        if _kept(grid, attitude) is not None and _kept(grid, motors) is not None:
            break
    return grid


def _kept(grid: NDArray[np.float64], time: NDArray[np.float64]) -> NDArray[np.intp] | None:
    """The sample of ``time`` (N,) at each point of ``grid`` (T,), each once; None unless all lie within ``STAMP``."""
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    nearest = np.where(grid - time[after - 1] < time[after] - grid, after - 1, after)
    if np.all(np.abs(time[nearest] - grid) <= STAMP) and np.all(np.diff(nearest) > 0):
        return nearest
    return None


def _sample(
    grid: NDArray[np.float64], time: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], bool]:
    """Columns of ``values`` (N, k) at ``grid`` (T,), and whether they are the samples themselves."""
    kept = _kept(grid, time)
    if kept is not None:
        return values[kept], True
    return np.column_stack([np.interp(grid, time, column) for column in values.T]), False
