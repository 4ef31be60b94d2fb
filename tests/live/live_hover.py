"""The made-up hover as frames of a link, and what is made of them: live, piece by piece, and offline."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from hover import ARMED, MAV_AUTOPILOTS, MAV_TYPES, Hover
from mavlink_streams import message, read, tlog
from numpy.testing import assert_allclose

from mavdem.dataset.alignment import aligned_flight
from mavdem.dataset.attitude import attitude_of_axis
from mavdem.dataset.resampling import FILTER_EDGE_STEPS, LOW_PASS_RATIO, STAMP_RESOLUTION
from mavdem.dataset.segments import Segment
from mavdem.dataset.signals import Signals
from mavdem.live import LiveStream

NOW = 1_700_000_000.0


@dataclass(frozen=True)
class Flight:
    """How a hover is sent; ``clock`` is what the boot clock reads beyond the hover's own time, s."""

    hover: Hover = Hover(hovering=8.0)
    attitude: float = 100.0
    motors: float = 100.0
    clock: float = 0.0
    system: int = 1
    version: int = 2
    quaternion: bool = False
    kind: str = "QUADROTOR"
    autopilot: str = "ARDUPILOTMEGA"

    def frames(self, start=3.0, end=39.0):
        """What is sent from ``start`` to ``end`` of the hover's time, in its order."""
        return list(_timed_frames(self, start, end))

    def _attitude(self, start, end):
        """Yields the attitude messages from start to end: their time, s, name and fields."""
        for time in ticks(start, end, self.attitude):
            stamp = {"time_boot_ms": round((time + self.clock) * 1e3)}
            roll = float(self.hover.roll(time))
            rate = float(self.hover.roll_rate(time))
            if self.quaternion:
                half = {"q1": np.cos(roll / 2), "q2": np.sin(roll / 2)}
                yield time, "ATTITUDE_QUATERNION", stamp | half | {"rollspeed": rate}
            else:
                yield (
                    time,
                    "ATTITUDE",
                    stamp | {"roll": roll, "rollspeed": rate, "pitch": 0.01, "pitchspeed": 0.1},
                )

    def _motors(self, start, end):
        """Yields the motor outputs from start to end: the time, s, name and fields of each message."""
        times = ticks(start, end, self.motors)
        for time, outputs in zip(
            times, np.rint(self.hover.motors(np.array(times))).astype(int).tolist(), strict=True
        ):
            # A moment after the attitude of the same loop, as autopilots send them.
            stamp = round((time + 0.0002 + self.clock) * 1e6) % 2**32
            fields = {f"servo{motor + 1}_raw": output for motor, output in enumerate(outputs)}
            yield time + 0.0002, "SERVO_OUTPUT_RAW", {"time_usec": stamp} | fields

    def _heartbeats(self, start, end):
        """Yields heartbeats from start to end, which say that the vehicle is armed from 5 s to its landing."""
        identity = {"type": MAV_TYPES[self.kind], "autopilot": MAV_AUTOPILOTS[self.autopilot]}
        for time in ticks(start, end, 1.0):
            armed = ARMED * (5.0 <= time < self.hover.landed + 1.0)
            yield time + 0.0003, "HEARTBEAT", identity | {"base_mode": armed}

    def _climb(self, start, end):
        """Yields messages with the vertical speed from start to end: their time, s, name and fields."""
        for time in ticks(start, end, 10.0):
            stamp = {"time_boot_ms": round((time + self.clock) * 1e3)}
            yield (
                time + 0.0004,
                "LOCAL_POSITION_NED",
                stamp | {"vz": -float(self.hover.climb(np.array(time)))},
            )


@cache
def _timed_frames(flight, start, end):
    """Returns all frames of a flight from start to end, each with its time, s, in the order of time."""
    streams = (flight._attitude, flight._motors, flight._heartbeats, flight._climb)
    timed = by_time(*(stream(start, end) for stream in streams))
    return [
        (
            time,
            message(
                kind,
                flight.system,
                sequence=number % 256,
                version=flight.version,
                **values,
            ),
        )
        for number, (time, kind, values) in enumerate(timed)
    ]


def by_time(*streams):
    """All that is sent, in its order."""
    return sorted((entry for stream in streams for entry in stream), key=lambda entry: entry[0])


def ticks(start, end, rate):
    """Returns the times from start to end, s, at which something is sent at a rate, Hz."""
    return (np.arange(round(start * rate), round(end * rate)) / rate).tolist()


class Replay:
    """What came of a stream: rows and when each of them came, s, events, set-ups by segment, and what was taken back.

    That is by segment the time since which its settled rows were of a landing.
    """

    def __init__(self, stream):
        self.stream = stream
        self.rows = []
        self.came = []
        self.events = []
        self.setups = {}
        self.taken_back = []

    @property
    def facts(self):
        return [event.fact for event in self.events]

    @property
    def codes(self):
        return [fact.code for fact in self.facts]

    def segments(self):
        """The rows by the number of their segment."""
        rows_by_segment = {}
        for row in self.rows:
            rows_by_segment.setdefault(row.segment, []).append(row)
        return rows_by_segment

    def table(self):
        """The rows as an array (T, 9): time, motor inputs, outputs, segment, and whether flight was settled."""
        return np.array(
            [
                [row.time, *row.inputs, *row.outputs, row.segment, row.is_settled]
                for row in self.rows
            ]
        )


def replay(pieces, stream=None, **options):
    """Feeds pieces of a link's bytes to a live stream, each at its time, and returns what the stream made of them."""
    replayed = Replay(stream or LiveStream(**options))
    for time, piece in pieces:
        rows = replayed.stream.feed(NOW + time, piece)
        if rows:
            replayed.rows += rows
            replayed.came += [time] * len(rows)
            replayed.setups[rows[-1].segment] = replayed.stream.row_format
        replayed.events += replayed.stream.drain_events()
        since = replayed.stream.pop_withdrawal_time()
        if since is not None and replayed.rows:
            replayed.taken_back.append((replayed.rows[-1].segment, since))
    return replayed


def offline(frames, system=1):
    """What the same frames are when they are read from a log."""
    log = read(tlog(list(frames)))
    return next(vehicle for vehicle in log.vehicles if vehicle.system == system)


def differences(replayed, segment, telemetry, axis="roll"):
    """Compares rows of a live segment with the samples that ``aligned_flight`` makes of the same log.

    Returns the largest differences of times, outputs and inputs. The offline segment is the one whose grid begins with
    the live one's; at its end one may know a message more.
    """
    rows = replayed.segments()[segment]
    row_format = replayed.setups[segment]
    stamps = attitude_of_axis(telemetry, axis)
    stamps_of_boot = stamps.time[stamps.boot == row_format.boot]
    margin = (
        FILTER_EDGE_STEPS * row_format.dt
        if max(row_format.rates) * row_format.dt >= LOW_PASS_RATIO
        else 0.0
    )
    start = stamps_of_boot[
        np.searchsorted(stamps_of_boot, row_format.grid_start - margin + STAMP_RESOLUTION) - 1
    ]
    flight = aligned_flight(
        Signals(telemetry, axis),
        Segment(row_format.boot, float(start), rows[-1].time + margin + 0.9 * row_format.dt),
    )
    assert flight.dt == row_format.dt
    flight = flight[round((rows[0].time - row_format.grid_start) / row_format.dt) :]
    live_rows = np.array([[row.time, *row.outputs, *row.inputs] for row in rows])
    aligned_rows = np.column_stack([flight.time, flight.outputs, flight.inputs])
    count = min(len(live_rows), len(aligned_rows))
    assert abs(len(live_rows) - len(aligned_rows)) <= 1
    times, *value_differences = abs(live_rows[:count] - aligned_rows[:count]).max(axis=0).tolist()
    return times, max(value_differences[:2]), max(value_differences[2:])


def settled_uniform(replayed):
    """Within a segment rows are one step apart, whatever happened."""
    for number, rows in replayed.segments().items():
        assert_allclose(np.diff([row.time for row in rows]), replayed.setups[number].dt, atol=1e-9)
