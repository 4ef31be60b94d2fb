"""Alignment: segments of settled flight without gaps, and their attitude and inputs on one uniform clock: a Flight."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from mavdem.arrays import Array, Flags
from mavdem.dataset import phases
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.drive import Motors, Signal
from mavdem.dataset.phases import Intervals, both, unbroken
from mavdem.dataset.signals import MINIMUM_RATE, Signals, axis_outputs, held, once
from mavdem.facts import Fact
from mavdem.facts.learnability import Resampling
from mavdem.flight import Flight
from mavdem.ingest.mavlink.definitions import decoded_parameters, latest_parameters
from mavdem.ingest.telemetry import (
    MAX_GAP_SECONDS,
    Columns,
    Parameters,
    interpolated,
    selected_rows,
)
from mavdem.ingest.vocabulary import AUTOPILOT_SET_PARAMETERS, CONTROL_PARAMETERS

MEDIAN_STEPS = 41
"""Steps, about 1 s at ``MINIMUM_RATE``, whose median is a stream's usual step. A median follows a change of rate to the
very step, and is not moved by the loss of a fifth of the messages."""
STEP_TOLERANCE = 1.1
"""How much longer than 1/``MINIMUM_RATE`` usual steps may be, so that jitter of the stamps does not split a stream.
Learnability decides whether the mean rate of a segment is enough."""
# Share of steps below which they are rare, and cycles of a scheduler that an interval may be.
USUAL_SHARE = 0.02
MAX_CYCLES = 3
# Resolution of ``time_boot_ms``: two stamps no further apart may belong to the same moment
STAMP_SECONDS = 1e-3


@dataclass(frozen=True, order=True)
class Segment:
    """Settled flight from ``start`` to ``end``, seconds on one boot's clock, with attitude and inputs throughout."""

    boot: int
    start: float
    end: float

    @property
    def duration(self) -> float:
        """Seconds from start to end."""
        return self.end - self.start


Segments = Sequence[Segment]
"""Of one flight, or of a log."""


@once()
def recorded_parts(signals: Signals) -> Segments:
    """Returns each boot from its first message to its last, but for texts: a log may begin with older ones."""
    messages = [
        columns for name, columns in signals.telemetry.messages.items() if name != "STATUSTEXT"
    ]
    if not messages:
        return ()
    time, boot = (
        np.concatenate([columns[name] for columns in messages]) for name in ("time", "boot")
    )
    parts = []
    for number in np.unique(boot[np.isfinite(time)]):
        stamps = time[(boot == number) & np.isfinite(time)]
        parts.append(Segment(int(number), float(stamps.min()), float(stamps.max())))
    return tuple(parts)


@once("axis", "inputs")
def settled_segments(signals: Signals) -> Segments:
    """Returns segments of one boot each: armed, airborne, settled, upright, fast and without gaps; the longest first.

    A step longer than ``MAX_GAP_SECONDS``, or messages that usually come slower than ``MINIMUM_RATE``, end a segment:
    ground stations change the rates in flight. Only where that leaves no segment at all is any rate allowed, and steps
    of three intervals; learnability then decides.
    """
    segments: list[Segment] = []
    for unbroken_runs in (_fast, _at_any_rate):
        sampled = _sampled(signals, unbroken_runs, lambda boot: phases.settled(signals, boot))
        segments = segments or [segment for segment in sampled if segment.duration >= 1.0]
    return tuple(sorted(segments, key=lambda segment: -segment.duration))


def longest_recorded(signals: Signals) -> Segment | None:
    """Returns the longest part, flown or not, with attitude and inputs without gaps, at any rate; None without any."""
    sampled = _sampled(signals, _at_any_rate, lambda _: [(-np.inf, np.inf)])
    return max(sampled, key=lambda segment: segment.duration, default=None)


def _sampled(
    signals: Signals,
    unbroken_runs: Callable[[Array], Intervals],
    wanted: Callable[[int], Intervals],
) -> Iterator[Segment]:
    """Where both streams are unbroken, in the ``wanted`` intervals of each boot."""
    attitude = signals.attitude
    drive = signals.drive
    if attitude is not None and drive is not None:
        for boot in np.intersect1d(attitude.boot, drive.boot):
            runs = (unbroken_runs(stream.time[stream.boot == boot]) for stream in (attitude, drive))
            for span in both(both(*runs), wanted(int(boot))):
                if is_sampled(attitude, drive, segment := Segment(int(boot), *span)):
                    yield segment


def within(
    stream: Attitude | Motors | Signal, *segments: Segment, slack: float = STAMP_SECONDS
) -> Flags:
    """Returns which samples (N,) belong to the segments, those up to ``slack``, s, beyond an end included."""
    inside = np.zeros(len(stream.time), dtype=bool)
    for part in segments:
        near = (stream.time >= part.start - slack) & (stream.time <= part.end + slack)
        inside |= near & (stream.boot == part.boot)
    return inside


def is_sampled(attitude: Attitude, motors: Motors, segment: Segment) -> bool:
    """Returns whether both streams have the two samples in the segment that a rate takes, and a time in common."""
    near = attitude.time[within(attitude, segment)]
    driven = motors.time[within(motors, segment)]
    return len(near) > 1 < len(driven) and bool(
        max(near[0], driven[0]) <= min(near[-1], driven[-1])
    )


def _fast(time: Array) -> Intervals:
    """Where the stamps (N,) of one boot come at ``MINIMUM_RATE`` or faster and without gaps."""
    steps = np.diff(time)
    return unbroken(time, usually_slow(steps) | (steps > MAX_GAP_SECONDS)) if len(time) > 1 else []


def usually_slow(steps: Array) -> Flags:
    """Returns which steps (N,) between the stamps of one boot are usually too long for ``MINIMUM_RATE``."""
    return median_filter(steps, size=MEDIAN_STEPS, mode="mirror") > STEP_TOLERANCE / MINIMUM_RATE


def _at_any_rate(time: Array) -> Intervals:
    """Where the stamps (N,) of one boot come without gaps, by the measure of their own usual step."""
    steps = np.diff(time)
    return (
        unbroken(time, steps > max(MAX_GAP_SECONDS, 3 * np.median(steps))) if len(time) > 1 else []
    )


LOW_PASS_RATIO = 1.5
"""A stream that comes so many times as fast as the grid is low-passed first. Below that the filter would reach into the
band in which the stream itself is already aliased."""
CUTOFF_RATIO = 0.4
"""Cut-off of that filter in grid rates: 0.5 is the Nyquist frequency, and 0.1 (5 Hz at 50) passes unchanged."""
FILTER_EDGE_STEPS = 5
"""Grid steps after which the filter has forgotten its start to a hundredth. Its slowest pole, at a rate of 2 pi
``CUTOFF_RATIO`` sin(22.5°), decays by a factor e a step."""


@once("axis", "inputs")
def align(signals: Signals, segment: Segment, dt: float | None = None) -> Flight:
    """Returns the flight of a sampled ``segment``, uniform on the boot clock, in steps of ``dt``, s.

    Its inputs are one column a motor, or the demand (``Signals.drive``), its outputs angle and rate of the axis, of yaw
    the rate only.

    Unless given, the step is the mean interval of the slower of attitude and motors, to 0.1 ms. The mean, because an
    autopilot that rounds 10 ms to its 4 ms loop alternates 8 and 12 and the median is neither (but see ``_interval``).

    A stream with a sample within ``STAMP_SECONDS`` of every grid point keeps its samples as they are, unless it is so
    much faster that it has to be low-passed (see :func:`sample`). Otherwise it is interpolated linearly.

    A motor output is held by the ESC, but only until the mixer's next turn, a few ms later and long before the next
    message. Holding the last message would date every input half an interval late on average, a lag the model would
    learn; interpolation has none. It looks one message ahead: an input between two messages uses up to one interval of
    the future. Setpoints are held (see ``setpoints``).
    """
    attitude, motors = signals.streams
    telemetry = signals.telemetry
    axis = signals.axis
    near = within(attitude, segment)
    stamps = attitude.time[near]
    measured = axis_outputs(axis)
    motion = np.column_stack([attitude.angle, attitude.rate])[:, -len(measured) :]
    drive = within(motors, segment)
    driven = motors.time[drive]
    rates = {"attitude": mean_rate(stamps), "motors": mean_rate(driven)}
    dt = step((stamps, driven)) if dt is None else dt
    time = grid_of(stamps, driven, dt)
    outputs, attitude_way = sample(time, dt, stamps, motion[near])
    inputs, motors_way = sample(time, dt, driven, motors.outputs[drive])
    layout = motors.layout
    scale = motors.scale
    asked = signals.setpoints
    return Flight(
        time=time,
        inputs=inputs,
        outputs=outputs,
        dt=dt,
        input_names=layout.names,
        output_names=tuple(name for name, _ in measured),
        input_units=(scale.unit,) * len(layout.names),
        output_units=tuple(unit for _, unit in measured),
        provenance={
            **{
                name: getattr(telemetry, name)
                for name in ("source", "system", "component", "vehicle", "autopilot")
            },
            "axis": axis,
            "segment": asdict(segment),
            "messages": {"attitude": attitude.message, "motors": motors.message},
            "rates": {name: round(rate, 3) for name, rate in rates.items()},
            "dt": dt,
            "resampling": {"attitude": str(attitude_way), "motors": str(motors_way)},
            "motors": {
                "channels": list(layout.channels),
                "positions": [list(position) for position in layout.positions],
                "basis": str(layout.basis),
                "channels_assumed": layout.channels_assumed,
                "positions_assumed": layout.positions_assumed,
                "spins": list(layout.spins),
            },
            "scale": asdict(scale),
            "setpoints": {
                setpoint.name: telemetry.name_in_source(setpoint.message) for setpoint in asked
            },
            "repairs": list(map(str, telemetry.repairs)),
            "parameters": {
                name: value
                for name, value in telemetry.parameters.items()
                if CONTROL_PARAMETERS.match(name)
            },
            "earlier": _earlier(signals, segment),
        },
        effect_directions=None if layout.positions_assumed else layout.mixer_row(axis),
        setpoints=np.column_stack([held(setpoint, segment.boot, time) for setpoint in asked])
        if asked
        else None,
        setpoint_names=tuple(setpoint.name for setpoint in asked),
        setpoint_units=tuple(setpoint.unit for setpoint in asked),
    )


@once()
def _changed(signals: Signals) -> Columns:
    """The messages of parameters that had other values than the last: few, where many boots send all again."""
    telemetry = signals.telemetry
    sent = telemetry.messages["PARAM_VALUE"]
    named = decoded_parameters(sent, telemetry.autopilot)
    changed = {name for name, value in named if value != telemetry.parameters.get(name)}
    return selected_rows(sent, np.array([name in changed for name, _ in named], dtype=bool))


def _earlier(signals: Signals, segment: Segment) -> Parameters:
    """The controller's parameters that changed after the segment began, or sometime, with their values before."""
    telemetry = signals.telemetry
    before = telemetry.initial_parameters
    if "PARAM_VALUE" in telemetry.messages:
        sent = _changed(signals)
        rows = (sent["boot"] < segment.boot) | (
            (sent["boot"] == segment.boot) & (sent["time"] <= segment.start)
        )
        before = latest_parameters(selected_rows(sent, rows), telemetry.autopilot)
    return {
        name: value
        for name, value in before.items()
        if CONTROL_PARAMETERS.match(name)
        and not AUTOPILOT_SET_PARAMETERS.search(name)
        and telemetry.parameters[name] != value
    }


def step(streams: Iterable[Array]) -> float:
    """Returns the step, s, of a grid for streams with these stamps (N,): the interval of the slowest, to 0.1 ms."""
    return max(round(max(map(_interval, streams)), 4), 1e-4)


def _interval(time: Array) -> float:
    """The mean interval, s, of stamps (N,); with jitter of a scheduler's whole cycles, the nearest two or three cycles.

    Steps of 4, 8 and 12 ms are 8 ms with jitter, whatever the mean of some seconds. 8 and 12 alone are their mean.
    """
    mean = 1 / mean_rate(time)
    since = time - time[0]
    steps, counts = np.unique(
        np.rint(np.diff(time) / STAMP_SECONDS).astype(int), return_counts=True
    )
    steps = steps[counts >= USUAL_SHARE * len(time)]
    cycle = STAMP_SECONDS * np.gcd.reduce(steps)
    usual = cycle * min(round(mean / cycle), MAX_CYCLES) if cycle else mean
    even = (
        np.mean(abs(since - cycle * np.rint(since / (cycle or 1.0))) > STAMP_SECONDS) < USUAL_SHARE
    )
    jitter = even and steps[0] * STAMP_SECONDS < usual - STAMP_SECONDS
    return usual if jitter and abs(usual / mean - 1) <= STEP_TOLERANCE - 1 else mean


def mean_rate(time: Array) -> float:
    """Returns the mean rate, samples a second, over the whole of ``time`` (N,), N ≥ 2."""
    return float((len(time) - 1) / (time[-1] - time[0]))


def sample(grid: Array, dt: float, time: Array, values: Array) -> tuple[Array, Fact]:
    """Resamples the columns of ``values`` (N, k) from ``time`` (N,) to ``grid`` (T,) of step ``dt``, and says how.

    Kept, interpolated linearly between the neighbours or, from a stream at ``LOW_PASS_RATIO`` times the rate of the
    grid or more, low-passed before: else a vibration at 49 Hz, on a grid of 50, would look slow.
    """
    way = Fact(Resampling.INTERPOLATED)
    if is_low_passed(time, dt):
        time, values = _low_passed(time, values, CUTOFF_RATIO / dt)
        way = Fact(Resampling.LOW_PASSED, rate=CUTOFF_RATIO / dt)
    elif (rows := kept_rows(grid, time)) is not None:
        return values[rows], Fact(Resampling.SAMPLES_KEPT)
    return interpolated(grid, time, values), way


def grid_of(attitude: Array, motors: Array, dt: float) -> Array:
    """Returns the steps of ``dt`` where both streams have samples.

    From an attitude sample when both streams then keep theirs; otherwise from a motor sample: motor outputs change more
    from one message to the next, so it is attitude that should be moved.
    """
    first = max(attitude[0], motors[0])
    last = min(attitude[-1], motors[-1])
    for stamps in (attitude, motors):
        start = min(stamps[stamps >= first - STAMP_SECONDS][0], last)
        grid = start + dt * np.arange(int((last - start) / dt + STAMP_SECONDS) + 1)
        if kept_rows(grid, attitude) is not None and kept_rows(grid, motors) is not None:
            break
    sure = _sure(grid, dt, attitude) & _sure(grid, dt, motors)
    return grid[sure] if sure.any() else grid


def kept_rows(grid: Array, time: Array) -> NDArray[np.intp] | None:
    """Returns the rows of ``time`` (N,) at each point of ``grid`` (T,).

    None unless all differ and lie within ``STAMP_SECONDS``.
    """
    nearest = np.searchsorted((time[1:] + time[:-1]) / 2, grid, side="right")
    kept = np.all(abs(time[nearest] - grid) <= STAMP_SECONDS) and np.all(np.diff(nearest) > 0)
    return nearest if kept else None


def is_low_passed(time: Array, dt: float) -> bool:
    """Returns whether a stream sampled at ``time`` (N,) is so much faster than a grid of ``dt`` to be low-passed."""
    return mean_rate(time) * dt >= LOW_PASS_RATIO


def _sure(grid: Array, dt: float, time: Array) -> Flags:
    """Which grid points (T,) are free of edge effects of the stream's low-pass filter, if there is one."""
    margin = FILTER_EDGE_STEPS * dt if is_low_passed(time, dt) else 0.0
    return (grid >= time[0] + margin - STAMP_SECONDS) & (grid <= time[-1] - margin + STAMP_SECONDS)


def _low_passed(time: Array, values: Array, cutoff: float) -> tuple[Array, Array]:
    """The columns at as many even stamps, through a Butterworth filter of fourth order, forwards and then backwards.

    Flat where the dynamics are, and without phase. At the cut-off half the amplitude is left, at twice that 1/257.
    """
    even = np.linspace(time[0], time[-1], len(time))
    table = interpolated(even, time, values)
    rate = mean_rate(time)
    # A slower filter's numbers are lost in rounding; whatever is sampled on so coarse a grid is refused for its rate.
    cutoff = max(cutoff, 1e-4 * rate)
    # until it settles
    return even, _filtered(table, rate, cutoff, min(round(3 * rate / cutoff), len(table) - 1))


def impulse_response(rate: float, dt: float) -> Array:
    """Returns (2 L + 1,) response of the low-pass filter to one sample of a stream of ``rate`` Hz.

    It is for streams as they come. It reaches ``FILTER_EDGE_STEPS`` steps ``dt`` either way; what is cut off beyond is
    less than a hundredth of it.
    """
    reach = round(FILTER_EDGE_STEPS * dt * rate)
    sample = np.zeros(8 * reach + 1)
    sample[4 * reach] = 1.0
    response = _filtered(sample, rate, CUTOFF_RATIO / dt, 0)[3 * reach : 5 * reach + 1]
    return response / response.sum()


def _filtered(values: Array, rate: float, cutoff: float, padding: int) -> Array:
    # it takes half a second to import, and few flights need it
    from scipy.signal import butter, sosfiltfilt

    return sosfiltfilt(butter(4, cutoff, fs=rate, output="sos"), values, axis=0, padlen=padding)
