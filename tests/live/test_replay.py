"""The live path beside the offline one, on the made-up hover and on recorded flights."""

import struct
from functools import lru_cache

from live_hover import Flight, differences, offline, replay
from numpy.testing import assert_array_equal
from pytest import mark, param
from recorded_flights import FLIGHT, LOGS, SAMPLE_LOGS, SHARED

from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.phases import TRANSIENT_SECONDS
from mavdem.dataset.segments import settled_segments
from mavdem.dataset.signals import MIN_STREAM_RATE, Signals
from mavdem.dataset.time_series import AVERAGING_SECONDS
from mavdem.facts.session import RowsFact
from mavdem.ingest import read_log
from mavdem.ingest.formats import read_stream
from mavdem.live.vehicle_review import REVIEW_PERIOD

pytestmark = [mark.slow, mark.usefixtures("without_alarms")]

RECORDED = (
    [FLIGHT, *SAMPLE_LOGS]
    + sorted(SHARED.glob("sitl_*/*.tlog"))
    + sorted(SHARED.glob("logs/*.tlog"))
)
AS_ANOTHER = (
    "ardupilot_calm",
    "ardupilot_wind6_gusts",
    "ardupilot_wind5_gustmoment_strong",
    "ardupilot_inertia_wind5_steps",
    "ardupilot_wind5_turb",
    "px4_calm",
    "px4_windjump",
    "ardupilot_wind4_doublets",
    "px4_wind5_gust",
    "ardupilot_wind5_mav1_50hz",
    "px4_wind5_gcsdefault",
    "lucagemma_crlf",
    "px4_wind5_steps",
)
"""Flown as another of the recorded flights is, in other wind or at another rate, or the whole of a sample flight."""
TWO_VEHICLES = "px4_two_vehicles_gcslink"
TO_THE_RESTART = "ap_reboot_rates_never_asked_again"
"""A simulated flight that is replayed whole: the autopilot restarts in it, and sends HEARTBEATs alone then."""
SECONDS = {
    "ap_short_with_climb": 68.0,
    "px4_rate_change_13.8ms": 26.0,
    "ardupilot_wind5_steps": 94.0,
    "px4_wind5_steps": 64.0,
    "dronekit_flight": 60.0,
    "wlichon_baseline": 93.0,
    "bluerobotics_00025": 15.0,
}
"""Seconds that are replayed where 45 s are too few or too many: for 15 s of flight, up to the ground, or no flight."""
NO_CLIMB = "ap_motor"
"""Without a vertical speed: offline, a descent is settled but for its end; live, not in a mode that lands."""
KNOWN_LATER = AVERAGING_SECONDS / 2 + REVIEW_PERIOD + 0.25
"""Seconds after which the end of the climb-out is known: half of the averaging, and a message of vertical speed."""


# A response is cut off where a hundredth of it is left: so much of what it passes over, take-off included.
LOW_PASSED = 0.01 * 0.5, 0.01 * 600
EXACT = 1e-12, 1e-9


@mark.parametrize(
    "flight, far, latency",
    [
        (Flight(version=1, quaternion=True, system=7), EXACT, 0.0),
        param(
            Flight(attitude=120.0, motors=110.0, clock=2**32 / 1e6 - 25),
            EXACT,
            1 / 110,
            marks=mark.in_full,
        ),
        param(Flight(attitude=250.0), LOW_PASSED, 5 * 0.01 + 1 / 250, marks=mark.in_full),
        param(Flight(motors=250.0), LOW_PASSED, 5 * 0.01 + 1 / 250, marks=mark.in_full),
        (Flight(motors=50.0), LOW_PASSED, 5 * 0.02 + 1 / 50),
    ],
)
def test_rows_are_those_of_align(flight, far, latency):
    """The rows of a live stream equal the samples that are made of the same messages offline.

    Each is reported with the message that completes it: no later than the ``latency``, s of the boot clock. There is
    none where samples are kept, and a step where they are read off the line.
    """
    frames = flight.frames(end=14.0)
    replayed = replay(frames)
    assert replayed.segments().keys() == {0}
    times, outputs, inputs = differences(
        replayed, 0, offline([data for _, data in frames], flight.system)
    )
    assert times < 1e-6 and outputs < far[0] and inputs < far[1]
    # The first rows come together, once their segment has begun.
    arrivals = zip(replayed.came, replayed.rows, strict=True)
    delays = [at + flight.clock - row.time for at, row in arrivals]
    assert max(delays[len(delays) // 10 :]) < latency + 0.001


def test_rows_do_not_depend_on_how_bytes_are_cut():
    """The stream receives the same bytes frame by frame, 11 bytes at a time, and all at once."""
    frames = Flight(attitude=50.0, motors=50.0).frames(end=14.0)
    replayed_in_frames = replay(frames)
    content = b"".join(data for _, data in frames)
    pieces = replay(
        [(0.0, content[position : position + 11]) for position in range(0, len(content), 11)]
    )
    assert_array_equal(pieces.table(), replayed_in_frames.table())
    assert pieces.facts == replayed_in_frames.facts
    assert pieces.stream.status() == replayed_in_frames.stream.status()
    assert_array_equal(replay([(0.0, content)]).table(), replayed_in_frames.table())


def recorded(path):
    return [(stamp / 1e6 - 1.7e9, data) for stamp, data in read_stream(path).stamped_frames()]


@lru_cache(1)
def group_by_vehicle(path):
    return read_log(path).vehicles


def first_seconds(path, folder, seconds):
    """The frames that were received in the first seconds."""
    frames = read_stream(path).stamped_frames()
    (first_stamp, first) = next(frames)
    shortened_log = folder / path.name
    later_frames = (
        (stamp, frame) for stamp, frame in frames if stamp < first_stamp + 1e6 * seconds
    )
    shortened_log.write_bytes(
        b"".join(
            struct.pack(">Q", stamp) + frame
            for stamp, frame in ((first_stamp, first), *later_frames)
        )
    )
    return shortened_log


def hold_against_offline(path):
    """Compares the rows of a replayed log with its samples offline: values, and which of them are settled flight."""
    telemetry = choose_vehicle(group_by_vehicle(path), None)
    replayed = replay(recorded(path))
    settled = settled_segments(Signals(telemetry))
    fast = [segment for segment in settled if segment.duration > 10]
    if not replayed.rows:
        if settled:
            assert RowsFact.LIVE_RATES_TOO_LOW in replayed.codes
        return
    assert fast
    covered = 0.0
    for number, rows in replayed.segments().items():
        next_setup = replayed.setups.get(number + 1, replayed.setups[number])
        if next_setup.dt < replayed.setups[number].dt and rows[-1].time - rows[0].time < 5.0:
            # Its last samples come at the higher rate, which counts in the mean rate of so short a segment.
            continue
        times, outputs, inputs = differences(replayed, number, telemetry)
        assert times < 1e-6
        assert outputs < 1e-9
        # Where a message was lost the offline path reads all of the segment off the line: up to a stamp's resolution.
        assert inputs < 0.01
        boot = replayed.setups[number].boot
        for row in rows:
            inside = any(
                one.boot == boot and one.start - 1e-3 <= row.time <= one.end + 1e-3 for one in fast
            )
            settling = any(one.start - 1e-3 <= row.time <= one.start + KNOWN_LATER for one in fast)
            # Before the landing, offline, TRANSIENT_SECONDS and the sinking are cut off, which live are known later.
            landing = any(one.end <= row.time <= one.end + KNOWN_LATER for one in fast)
            landing |= row.time >= rows[-1].time - TRANSIENT_SECONDS - KNOWN_LATER
            landing |= any(
                segment == number and row.time >= since for segment, since in replayed.taken_back
            )
            may_be_settled = inside or landing
            must_be_settled = inside and not settling
            if row.is_settled:
                assert may_be_settled
            else:
                assert not must_be_settled
            covered += row.is_settled * replayed.setups[number].dt
    assert covered > 0.9 * sum(segment.duration for segment in fast) - KNOWN_LATER - 2.0
    assert 1 / replayed.setups[0].dt >= MIN_STREAM_RATE


@mark.parametrize(
    "path",
    [
        param(path, marks=() if path in SAMPLE_LOGS else mark.in_full, id=path.stem)
        for path in RECORDED
        if path.stem not in (TWO_VEHICLES, NO_CLIMB, *AS_ANOTHER) or path.parent == LOGS
    ],
)
def test_a_recorded_flight_gives_what_it_gives_offline(path, tmp_path):
    """The first seconds of real logs are replayed, since they have more irregularities than made-up flights.

    All but the samples are replayed with ``--in-full``.
    """
    if path.stem != TO_THE_RESTART:
        path = first_seconds(path, tmp_path, SECONDS.get(path.stem, 45.0))
    if "SUBMARINE" in {vehicle.vehicle for vehicle in group_by_vehicle(path)}:
        assert not replay(recorded(path)).rows
    else:
        hold_against_offline(path)
