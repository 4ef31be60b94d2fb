"""From Telemetry to a Flight: choose a stretch of settled flight and put motors and attitude on one uniform clock."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import butter, sosfiltfilt

from mavdem import phases
from mavdem.flight import Flight
from mavdem.ingest import meaning
from mavdem.ingest.meaning import AXES, Attitude, Motors
from mavdem.intervals import Intervals, both, unbroken
from mavdem.telemetry import Telemetry

INPUTS = ("motors", "demand")
"""What a model's inputs may be: the motors' outputs, or what the controller asked of the axis."""

MINIMUM_RATE = 40.0
"""Hz, of attitude and of motors.

Ten times the roughly 4 Hz at which a multirotor's roll loop crosses over, and what is left of a 50 Hz stream on a link
that loses a fifth. On recorded flights motors add nothing to a forecast at 1-10 Hz and do at 50."""

USUAL = 41
"""Steps, about 1 s at ``MINIMUM_RATE``, over which a stream's usual step is taken: the median of as many.

A median, because it follows a change of rate to the very step, and does not see that a fifth of the messages is lost.
"""

SLACK = 1.1
"""How much longer than 1/``MINIMUM_RATE`` usual steps may be: jitter of the stamps must not part a stream of that rate.

Whether the mean rate of a stretch is enough is the verdict's business."""

GAP = 0.1
"""Longest silence, s, that may be bridged: half a period of the 5 Hz at which roll dynamics still live."""

SHORTEST = 1.0
"""Seconds below which a stretch is not worth listing."""

STAMP = 1e-3
"""Resolution, s, of ``time_boot_ms``: two stamps no further apart may belong to the same moment."""

DECIMATED = 1.5
"""A stream that comes so many times as fast as the grid is low-passed first; below that the filter would reach into the
band in which the stream itself is already aliased."""

SLOWEST_FILTER = 1e-4
"""Of the stream's rate: the least cut-off that is filtered with."""

PASSED = 0.4
"""Cut-off of that filter in grid rates: 0.5 is the Nyquist frequency, and 0.1 (5 Hz at 50) passes unchanged."""

UNSURE = 5
"""Grid steps after which the filter has forgotten to a hundredth how it was begun: its slowest pole, at a rate of
2 pi ``PASSED`` sin(22.5°), decays by a factor e a step."""


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


def segments(telemetry: Telemetry, axis: str = "roll", inputs: str | None = None) -> tuple[Segment, ...]:
    """The stretches of one boot, armed, airborne, settled, upright, fast and without gaps; the longest first.

    A step longer than ``GAP``, or a while in which messages usually come slower than ``MINIMUM_RATE``, parts one
    stretch from the next: ground stations change the rates in flight. Only when that leaves no stretch at all is any
    rate allowed, and steps of three intervals: whether that can be learnt from is the verdict's business.

    Raises:
        ValueError: an axis that is neither "roll" nor "pitch".
    """
    attitude, motors = meaning.attitude(telemetry, axis), drive(telemetry, axis, inputs)
    other = meaning.attitude(telemetry, next(name for name in AXES if name != axis))
    if attitude is None or other is None or motors is None:
        return ()
    told = phases.Told.by(telemetry)
    found: list[Segment] = []
    for heard in (_fast, _at_any_rate):
        for boot in np.intersect1d(attitude.boot, motors.boot):
            together = both(heard(attitude.time[attitude.boot == boot]), heard(motors.time[motors.boot == boot]))
            for start, end in both(together, phases.settled(told, attitude, other, boot)):
                segment = Segment(int(boot), start, end)
                if segment.duration >= SHORTEST and _sampled(attitude, motors, segment):
                    found.append(segment)
        if found:
            break
    return tuple(sorted(found, key=lambda segment: -segment.duration))


def drive(telemetry: Telemetry, axis: str = "roll", inputs: str | None = None) -> Motors | None:
    """What drives the axis: the motors, or, where they come too slowly and it does not, the controller's demand.

    Args:
        telemetry: of one vehicle.
        axis: "roll" or "pitch".
        inputs: "motors" or "demand", to have just that.

    Returns:
        None where it was not recorded, or never moved.

    Raises:
        ValueError: an axis or inputs that are neither.
    """
    if inputs not in (None, *INPUTS):
        raise ValueError(f"inputs must be one of {', '.join(INPUTS)}, not {inputs!r}")
    motors = None if inputs == "demand" else meaning.motors(telemetry)
    demand = None if inputs == "motors" else meaning.demand(telemetry, axis)
    if demand is None or (motors is not None and usual_rate(motors) >= MINIMUM_RATE):
        return motors
    return demand if motors is None or usual_rate(demand) >= MINIMUM_RATE else motors


def usual_rate(stream: Attitude | Motors) -> float:
    """Messages a second between outages: steps of more than three usual ones, and those from boot to boot, left out."""
    steps = np.diff(stream.time)[np.diff(stream.boot) == 0]
    return 1 / float(steps[steps <= 3 * np.median(steps)].mean()) if len(steps) else 0.0


def align(telemetry: Telemetry, segment: Segment, axis: str = "roll", inputs: str | None = None) -> Flight:
    """The flight of ``segment``, uniform on the boot clock.

    Its inputs are one column a motor, or the demand (:func:`drive`), its outputs angle and rate of ``axis``.

    The step is the mean interval of the slower of attitude and motors, to 0.1 ms. The mean, because an autopilot that
    rounds 10 ms to its 4 ms loop alternates 8 and 12 and the median is neither.

    A stream with a sample within ``STAMP`` of every grid point keeps its samples as they are, unless there are so many
    more that it has to be low-passed (see :func:`sample`). Otherwise it is read off the line between its neighbours.

    A motor output is held by the ESC, but only until the mixer's next turn, a few ms later and long before the next
    message: the messages sample a signal that goes on changing between them. Holding the last message would date every
    input half an interval late on average, a lag the model would learn; the line has none. The line looks one message
    ahead: an input between two messages knows up to one interval of the future.

    Raises:
        ValueError: a segment without samples of attitude or motors, or an unknown axis or inputs.
    """
    attitude, motors = meaning.attitude(telemetry, axis), drive(telemetry, axis, inputs)
    if attitude is None or motors is None:
        raise ValueError("the telemetry holds no attitude or no motor outputs to align")
    return flight_of(telemetry, attitude, motors, segment, axis)


def flight_of(telemetry: Telemetry, attitude: Attitude, motors: Motors, segment: Segment, axis: str) -> Flight:
    """:func:`align` for whoever has the streams of ``telemetry`` at hand; they are costly to find anew each time.

    Raises:
        ValueError: a segment without samples of attitude or motors.
    """
    near, motion = within(attitude, segment), np.column_stack([attitude.angle, attitude.rate])
    drive = within(motors, segment)
    if not _sampled(attitude, motors, segment):
        raise ValueError(f"the segment from {segment.start:.3f} s holds no attitude or no motor outputs")
    rates = {"attitude": mean_rate(attitude.time[near]), "motors": mean_rate(motors.time[drive])}
    dt = step(rates.values())
    time = grid_of(attitude.time[near], motors.time[drive], dt)
    outputs, attitude_way = sample(time, dt, attitude.time[near], motion[near])
    inputs, motors_way = sample(time, dt, motors.time[drive], motors.outputs[drive])
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
            "resampling": {"attitude": attitude_way, "motors": motors_way},
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


def step(rates: Iterable[float]) -> float:
    """The step, s, of a grid for streams of these mean rates, Hz: the interval of the slowest, to 0.1 ms."""
    return max(round(1 / min(rates), 4), 1e-4)


def mean_rate(time: NDArray[np.float64]) -> float:
    """Samples a second over the whole of ``time`` (N,), N ≥ 2."""
    return float((len(time) - 1) / (time[-1] - time[0]))


def sample(
    grid: NDArray[np.float64], dt: float, time: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], str]:
    """Columns of ``values`` (N, k), sampled at ``time`` (N,), at ``grid`` (T,) of step ``dt``, and how they were made.

    "samples kept", "linear" between the neighbours, or, from a stream at ``DECIMATED`` times the rate of the grid or
    more, "low-passed at … Hz, linear": without that, what moves faster than the grid can show (a vibration at 49 Hz, on
    a grid of 50) would appear in it as something slow.
    """
    way = "linear"
    if decimated(time, dt):
        time, values = _low_passed(time, values, PASSED / dt)
        way = f"low-passed at {PASSED / dt:.3g} Hz, linear"
    elif (rows := kept(grid, time)) is not None:
        return values[rows], "samples kept"
    return np.column_stack([np.interp(grid, time, column) for column in values.T]), way


def within(stream: Attitude | Motors, segment: Segment) -> NDArray[np.bool_]:
    """Which samples (N,) of the stream belong to the segment, those within ``STAMP`` of its ends included."""
    inside = (stream.time >= segment.start - STAMP) & (stream.time <= segment.end + STAMP)
    return np.asarray(inside & (stream.boot == segment.boot))


def _sampled(attitude: Attitude, motors: Motors, segment: Segment) -> bool:
    """Whether both streams have the two samples in the segment that a rate takes, and a time in common."""
    near, drive = attitude.time[within(attitude, segment)], motors.time[within(motors, segment)]
    return len(near) > 1 < len(drive) and bool(max(near[0], drive[0]) <= min(near[-1], drive[-1]))


def _fast(time: NDArray[np.float64]) -> Intervals:
    """Where the stamps (N,) of one boot come at ``MINIMUM_RATE`` or faster and without gaps."""
    if len(time) < 2:
        return []
    steps = np.diff(time)
    return unbroken(time, _usually_slow(steps) | (steps > GAP))


def slow(time: NDArray[np.float64]) -> Intervals:
    """Where the stamps (N,) of one boot usually come slower than ``MINIMUM_RATE``; outages are not slow."""
    return unbroken(time, ~_usually_slow(np.diff(time))) if len(time) > 1 else []


def _usually_slow(steps: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(median_filter(steps, size=USUAL, mode="mirror") > SLACK / MINIMUM_RATE)


def _at_any_rate(time: NDArray[np.float64]) -> Intervals:
    """Where the stamps (N,) of one boot come without gaps, by the measure of their own usual step."""
    if len(time) < 2:
        return []
    steps = np.diff(time)
    return unbroken(time, steps > max(GAP, 3 * float(np.median(steps))))


def grid_of(attitude: NDArray[np.float64], motors: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """Steps of ``dt`` where both streams have samples.

    From an attitude sample when both streams then keep theirs; otherwise from a motor sample: from one message to the
    next motor outputs change more than attitude does, so it is attitude that should be moved.
    """
    first, last = max(attitude[0], motors[0]), min(attitude[-1], motors[-1])
    for stamps in (attitude, motors):
        start = min(stamps[stamps >= first - STAMP][0], last)
        grid = np.asarray(start + dt * np.arange(int((last - start) / dt + STAMP) + 1))
        if kept(grid, attitude) is not None and kept(grid, motors) is not None:
            break
    sure = _sure(grid, dt, attitude) & _sure(grid, dt, motors)
    return grid[sure] if sure.any() else grid


def kept(grid: NDArray[np.float64], time: NDArray[np.float64]) -> NDArray[np.intp] | None:
    """The sample of ``time`` (N,) at each point of ``grid`` (T,), each once; None unless all lie within ``STAMP``."""
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    nearest = np.where(grid - time[after - 1] < time[after] - grid, after - 1, after)
    if np.all(np.abs(time[nearest] - grid) <= STAMP) and np.all(np.diff(nearest) > 0):
        return nearest
    return None


def decimated(time: NDArray[np.float64], dt: float) -> bool:
    """Whether a stream, sampled at ``time`` (N,), is so much faster than a grid of ``dt`` that it is low-passed."""
    return mean_rate(time) * dt >= DECIMATED


def _sure(grid: NDArray[np.float64], dt: float, time: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points (T,) the low-pass of the stream, if there is one, gets right though it knows nothing of beyond."""
    margin = UNSURE * dt if decimated(time, dt) else 0.0
    return np.asarray((grid >= time[0] + margin - STAMP) & (grid <= time[-1] - margin + STAMP))


def _low_passed(
    time: NDArray[np.float64], values: NDArray[np.float64], cutoff: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The columns at as many even stamps, through a Butterworth filter of fourth order, once forwards, once backwards.

    Butterworth, because it is flat where the dynamics are; both ways, because that leaves no phase, and motors and
    attitude must keep their order in time. At the cut-off half the amplitude is left, at twice that 1/257.
    """
    even = np.linspace(time[0], time[-1], len(time))
    table = np.column_stack([np.interp(even, time, column) for column in values.T])
    rate = mean_rate(time)
    # A slower filter's numbers are lost in rounding; whatever is sampled on so coarse a grid is refused for its rate.
    cutoff = max(cutoff, SLOWEST_FILTER * rate)
    settling = round(3 * rate / cutoff)
    return even, sosfiltfilt(_passing(rate, cutoff), table, axis=0, padlen=min(settling, len(table) - 1))


def impulse_response(rate: float, dt: float) -> NDArray[np.float64]:
    """(2 L + 1,) what the low-pass of a stream of ``rate`` Hz makes of one sample, ``UNSURE`` steps ``dt`` either way.

    The same filter in a form that a stream can be put through while it comes. Its weights add up to 1: what is cut off
    beyond is less than a hundredth.
    """
    reach = round(UNSURE * dt * rate)
    sample = np.zeros(8 * reach + 1)
    sample[4 * reach] = 1.0
    response = sosfiltfilt(_passing(rate, PASSED / dt), sample, padlen=0)[3 * reach : 5 * reach + 1]
    return np.asarray(response / response.sum())


def _passing(rate: float, cutoff: float) -> NDArray[np.float64]:
    return np.asarray(butter(4, cutoff, fs=rate, output="sos"))
