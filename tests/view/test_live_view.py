"""A flight under way reaches a recording sample for sample, and nothing that shows it holds up who learns from it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from threading import Event, Timer
from urllib.parse import parse_qs, urlsplit

import numpy as np
import psutil
import pytest
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import RrdReader
from rerun_file import chunks, layouts, views
from scipy.stats import norm

import mavdem
from mavdem.dem import Estimate, LinearModel
from mavdem.live import SessionStatus
from mavdem.view.live import Channels, LiveView, RecordingFile, Viewer, WebServer, sinks_for
from mavdem.view.live.line_group import LineGroup
from mavdem.view.live.live_view import REBOOT_GAP_SECONDS, Timeline
from mavdem.view.live.rows import ViewRow
from mavdem.view.live.sink_thread import MAX_ROWS, Backlog, status_document

PATIENCE = 300.0  # Seconds that a slow, busy machine may take for anything; on others nothing waits for them
DT = 0.01
HORIZONS = (1, 25, 50)
CHANNELS = Channels(
    "vehicle 1 on udpin:127.0.0.1:14550",
    DT,
    HORIZONS,
    tuple(f"motor {i} (somewhere)" for i in range(1, 5)),
    ("roll", "roll rate"),
    ("µs",) * 4,
    ("rad", "rad/s"),
)
LATE = 0.04
"""Seconds from the centre of a window to its end."""


def model(seed: int) -> LinearModel:
    rng = np.random.default_rng(seed)
    sizes = (3, 3), (3, 4), (2, 3), (3,), (4,), (2,)
    return LinearModel(*(rng.uniform(0.1, 1.0, size) for size in sizes))


def estimate(i: int, time: float) -> Estimate:
    """All its numbers differ, and differ from those of other samples."""
    rng = np.random.default_rng(i)
    sizes = {"expected": 2, "expected_band": 2, "ahead": (3, 2), "ahead_band": (3, 2), "disturbance": 3}
    return Estimate(
        time=time,
        ahead_times=time + DT * np.array(HORIZONS),
        ahead_ratio=np.array([[0.1, 0.2], [0.3, 0.4], [0.7, 0.8]]),
        seen=time - LATE,
        free_energy=-100.0 - i,
        surprise=i % 50 / 10,
        unusual=i % 50 == 40,
        free_energy_action=-1000.0 - i // 10,
        model=MODELS[i // 10],
        model_sd=MODELS[i // 10 + 1],
        log_precisions=np.array([20.0, i // 10]),
        until=time - 0.1,
        wind_torque=np.nan if i < 40 else 0.1 * i,
        wind_torque_band=0.01 * i,
        wind_time=time - 0.25,
        **{name: rng.normal(size=size) for name, size in sizes.items()},
    )


MODELS = [model(seed) for seed in range(1000)]
TIME = 50.0 + DT * np.arange(300)
OUTPUTS = np.random.default_rng(1).normal(size=(300, 2))
INPUTS = np.random.default_rng(2).uniform(1000, 2000, size=(300, 4))
ESTIMATES = [None if i < 20 else estimate(i, t) for i, t in enumerate(TIME)]
TOLD = ESTIMATES[20:]


def drawn(path: Path) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Times, s, and values of every entity of lines, by path without its slash, in the order of their times."""
    times: dict[str, list[float]] = {}
    values: dict[str, list[list[float]]] = {}
    for name, _, batch in chunks(path):
        if "Scalars:scalars" in batch.schema.names:
            times.setdefault(name, []).extend(np.array(batch.column("boot clock").cast("int64")) / 1e9)
            values.setdefault(name, []).extend(batch.column("Scalars:scalars").to_pylist())
    return {name: (np.array(times[name]), np.array(values[name])) for name in times}


def texts(path: Path, column: str) -> list[str]:
    return [
        text[0]
        for *_, batch in chunks(path)
        if column in batch.schema.names
        for text in batch.column(column).to_pylist()
    ]


@pytest.fixture(scope="module", autouse=True)
def patience() -> Iterator[None]:
    """A file is waited for as long as a busy machine takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mavdem.view.live.live_view.CLOSE_SECONDS", PATIENCE)
        patch.setattr("mavdem.view.live.sink_thread.FLUSH_SECONDS", PATIENCE)
        yield


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("live") / "flight.rrd"
    with LiveView(CHANNELS, [RecordingFile(path)]) as view:
        view.log("attached", time=50.0)
        status = SessionStatus(
            rates={"ATTITUDE": 99.4}, lost=7, latency=(0.012, 0.02), learned=300, obstacle="the motors hardly move"
        )
        view.status(status)
        for row in zip(TIME, OUTPUTS, INPUTS, ESTIMATES, strict=True):
            t, y, u, known = row
            view.put(t, 0, y, u, known)
        view.log("link lost", "WARN")
    assert view.troubles == []
    assert view.dropped == {str(path): 0}
    return path


@pytest.mark.parametrize(("column", "name"), list(enumerate(CHANNELS.output_names)))
def test_outputs_are_those_that_were_put_in_degrees(recording: Path, column: int, name: str) -> None:
    times, values = drawn(recording)[f"outputs/{name}/now"]
    np.testing.assert_allclose(times, TIME, atol=1e-8)
    np.testing.assert_allclose(values[:, 3], np.degrees(OUTPUTS[:, column]))
    assert np.isnan(values[:20, :3]).all()
    centre, half = (np.array([getattr(e, part)[column] for e in TOLD]) for part in ("expected", "expected_band"))
    np.testing.assert_allclose(values[20:, :3], np.degrees(np.stack([centre - half, centre + half, centre], -1)))


@pytest.mark.parametrize(("column", "name"), list(enumerate(CHANNELS.output_names)))
def test_predictions_a_quarter_of_a_second_ahead_are_at_the_times_they_are_about(
    recording: Path, column: int, name: str
) -> None:
    times, values = drawn(recording)[f"outputs/{name}/ahead"]
    np.testing.assert_allclose(times, TIME + 25 * DT, atol=1e-8)
    centre, half = (np.array([getattr(e, part)[1, column] for e in TOLD]) for part in ("ahead", "ahead_band"))
    np.testing.assert_allclose(values[20:], np.degrees(np.stack([centre - half, centre + half, centre], -1)))


def test_the_longest_useful_horizon_is_shown_and_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the first batch whose errors say so; where none is useful, one step."""
    named: list[str] = []
    send = LineGroup.send_style
    monkeypatch.setattr(LineGroup, "send_style", lambda group, to: (named.extend(group.names), send(group, to))[1])
    for ratios, useful in (((0.1, 0.2, 0.3), 50), ((0.6, 0.7, 0.8), 1)):
        path = tmp_path / f"{useful}.rrd"
        with LiveView(CHANNELS, [RecordingFile(path)]) as view:
            told = estimate(20, TIME[0])._replace(ahead_ratio=np.outer(ratios, [1.0, 1.0]))
            view.put(TIME[0], 0, OUTPUTS[0], INPUTS[0], told)
        times, values = drawn(path)["outputs/roll/ahead"]
        place = HORIZONS.index(useful)
        np.testing.assert_allclose(times, [told.ahead_times[place]])
        np.testing.assert_allclose(values[0, 2], np.degrees(told.ahead[place, 0]))
        assert f"{useful * DT:.2g} s ahead" in named


def test_motors_are_those_that_were_put(recording: Path) -> None:
    times, values = drawn(recording)["inputs"]
    np.testing.assert_allclose(times, TIME, atol=1e-8)
    np.testing.assert_array_equal(values, INPUTS)


def test_what_is_judged_is_at_the_times_it_is_about(recording: Path) -> None:
    lines = drawn(recording)
    seen = np.array([e.seen for e in TOLD])
    surprise = np.array([e.surprise for e in TOLD])
    expected = {
        "free_energy_of_samples": np.array([[e.free_energy] for e in TOLD]),
        "disturbance": np.array([[e.model.C[1] @ e.disturbance] for e in TOLD]),  # of the rate: rad/s²
        "surprise/samples": np.stack([np.ones(len(TOLD)), surprise], axis=-1),
    }
    for path, values in expected.items():
        np.testing.assert_allclose(lines[path][0], seen, atol=1e-8)
        np.testing.assert_allclose(lines[path][1], values)
    unusual = np.array([e.unusual for e in TOLD])
    np.testing.assert_allclose(lines["surprise/unusual"][0], seen[unusual], atol=1e-8)
    np.testing.assert_allclose(lines["surprise/unusual"][1][:, 0], surprise[unusual])


def test_the_wind_s_torque_is_drawn_with_its_band_when_it_acted(recording: Path) -> None:
    times, values = drawn(recording)["disturbance/wind_torque"]
    np.testing.assert_allclose(times, TIME[20:] - 0.25, atol=1e-8)
    centre, half = 0.1 * np.arange(40, 300), 0.01 * np.arange(40, 300)
    np.testing.assert_allclose(values[20:], np.stack([centre - half, centre + half, centre], -1))
    assert np.isnan(values[:20]).all()


def test_a_model_is_drawn_once_with_its_band(recording: Path) -> None:
    lines = drawn(recording)
    known = range(2, 30)
    times, values = lines["parameters/A/2 from 1"]
    np.testing.assert_allclose(times, TIME[20::10], atol=1e-8)
    centre, half = (np.array([MODELS[i + more].A[1, 0] for i in known]) for more in (0, 1))
    half = norm.ppf(0.95) * half
    np.testing.assert_allclose(values, np.stack([centre - half, centre + half, centre], -1))
    np.testing.assert_allclose(lines["noise_precisions/λ 1/λ 2"][1], [[20.0, i] for i in known])
    np.testing.assert_allclose(lines["free_energy_action"][1][:, 0], [-1000.0 - i for i in known])


def test_log_and_status_show_what_they_were_given(recording: Path) -> None:
    assert texts(recording, "TextLog:text") == ["attached", "link lost"]
    assert texts(recording, "TextLog:level") == ["INFO", "WARN"]
    document = texts(recording, "TextDocument:text")[-1]
    for fact in (CHANNELS.title, "300 at 100 Hz", "99.4 Hz", "frames lost | 7", "12 ms", "The motors hardly move."):
        assert fact in document
    assert "learned up to 0.1 s ago" in document


def test_batches_are_not_tiny(recording: Path) -> None:
    sizes = [batch.num_rows for name, _, batch in chunks(recording) if name.startswith(("outputs", "inputs"))]
    assert np.mean(sizes) >= 100


def test_the_blueprint_shows_what_is_there(recording: Path) -> None:
    shown = views(recording)
    assert len(shown) == 12
    entities = {name for name, *_ in chunks(recording)}
    for origin in shown:
        assert any(f"{entity}/".startswith(f"{origin}/") for entity in entities), f"the view of {origin} is empty"


@pytest.mark.slow
def test_a_flight_is_shown_as_it_is_learnt_from(tmp_path: Path) -> None:
    log, path = Path(__file__).parents[2] / "logs" / "ardupilot_wind5_steps.tlog", tmp_path / "flight.rrd"
    flight = mavdem.read_flight(log)[:400]
    names, units = (flight.input_names, flight.output_names), (flight.input_units, flight.output_units)
    learner = mavdem.OnlineLearner(dt=flight.dt, n_inputs=4, n_outputs=2, horizons=HORIZONS)
    with LiveView(Channels(log.name, flight.dt, HORIZONS, *names, *units), [RecordingFile(path)]) as view:
        for now, outputs, inputs in zip(flight.time, flight.outputs, flight.inputs, strict=True):
            view.put(now, 0, outputs, inputs, learner.update(now, outputs, inputs), learner.learned)
    assert view.troubles == []
    lines = drawn(path)
    np.testing.assert_allclose(lines["outputs/roll/now"][1][:, 3], np.degrees(flight.outputs[:, 0]))
    assert len(lines["free_energy_of_samples"][0]) > 80
    free = {name for name in lines if name.startswith("parameters/")}
    # Of a rate and a hidden lag, and the motors' effect on both; that a rate is a rate is known beforehand.
    assert {f"parameters/A/roll rate from {column}" for column in ("roll", "roll rate")} <= free
    assert {f"parameters/B/roll rate from {motor}" for motor in flight.input_names} <= free
    assert not any("/roll from" in name or name.startswith("parameters/C") for name in free)
    assert "noise_precisions/w, process" in lines


def test_other_channels_are_drawn_apart_from_those_before(tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    demand = CHANNELS._replace(dt=0.02, horizons=(1, 12, 50), input_names=("roll demand",), input_units=("",))
    demand = demand._replace(output_units=("m", "m/s"))
    with LiveView(CHANNELS, [RecordingFile(path)]) as view:
        for i, channels in enumerate([CHANNELS, CHANNELS, demand, demand, demand, CHANNELS]):
            view.change(channels)
            view.put(TIME[i], 0, OUTPUTS[i], INPUTS[i][: len(channels.input_names)], estimate(20 + i, TIME[i]))
    assert view.troubles == [] and not [text for text in texts(path, "TextLog:text") if "not drawn" in text]
    lines = drawn(path)
    np.testing.assert_array_equal(lines["inputs"][1], INPUTS[[0, 1, 5]])
    np.testing.assert_array_equal(lines["setup_2/inputs"][1], INPUTS[2:5, :1])
    np.testing.assert_allclose(lines["outputs/roll/now"][1][:, 3], np.degrees(OUTPUTS[[0, 1, 5], 0]))
    np.testing.assert_allclose(lines["setup_2/outputs/roll/now"][1][:, 3], OUTPUTS[2:5, 0])
    np.testing.assert_allclose(lines["setup_2/outputs/roll/ahead"][0], TIME[2:5] + 0.25)
    assert any(name.startswith("setup_2/parameters/A") for name in lines)
    assert sum("other channels" in text for text in texts(path, "TextLog:text")) == 2
    # Three blueprints are sent; a file does not tell in which order.
    first, third, second = sorted(map(set, layouts(path)), key=lambda origins: "setup_2/inputs" in origins)
    assert first == third != second and first & second == {"status", "log"}
    assert all(any(f"{name}/".startswith(f"{origin}/") for name in lines) for origin in second - {"status", "log"})


def test_a_missing_stretch_parts_every_line(tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    with LiveView(CHANNELS, [RecordingFile(path)]) as view:
        for i in range(20):
            view.put(50.0 + DT * i + (i >= 10), int(i >= 10), OUTPUTS[i], INPUTS[i], estimate(20 + i, 50.0 + DT * i))
    lines = drawn(path)
    for name, width in (("inputs", 4), ("outputs/roll/now", 4), ("outputs/roll/ahead", 3)):
        times, values = lines[name]
        assert np.isnan(values[10]).all() and np.isfinite(np.delete(values, 10, axis=0)).all()
        assert values.shape == (21, width)
        assert times[9] < times[10] < times[11]


def test_time_goes_on_where_a_reboot_sets_the_clock_back(tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    with LiveView(CHANNELS, [RecordingFile(path)]) as view:
        for segment, start in enumerate((500.0, 3.0)):
            for i in range(10):
                t = start + DT * i
                view.put(t, segment, OUTPUTS[i], INPUTS[i], estimate(20, t))
            view.log("a remark")
    lines = drawn(path)
    shown = np.append(500.0 + DT * np.arange(10), 500.09 + REBOOT_GAP_SECONDS + DT * np.arange(10))
    times = lines["inputs"][0]
    np.testing.assert_allclose(np.delete(times, 10), shown, atol=1e-8)
    np.testing.assert_allclose(lines["free_energy_of_samples"][0], shown - LATE, atol=1e-8)
    assert (np.diff(times) > 0).all()
    told = texts(path, "TextLog:text")
    assert told[1] == "rebooted: 3.0 s is shown as 501.1 s"
    assert "3.1 s since a reboot; shown as 501.2 s" in texts(path, "TextDocument:text")[-1]


def test_a_line_about_a_moment_ago_is_no_reboot() -> None:
    timeline = Timeline()
    assert timeline.place(500.0) == 500.0
    assert timeline.place(499.0) == 499.0
    assert timeline.place(None) == timeline.place(float("nan")) == 500.0
    assert timeline.place(2.0) == 500.0 + REBOOT_GAP_SECONDS
    assert timeline.place(2.5) == 500.5 + REBOOT_GAP_SECONDS


def test_what_is_not_known_is_left_out(tmp_path: Path) -> None:
    learner = mavdem.OnlineLearner(dt=DT)
    path = tmp_path / "flight.rrd"
    with LiveView(CHANNELS, [RecordingFile(path)]) as view:
        for i in range(20):
            view.put(TIME[i], 0, OUTPUTS[i], INPUTS[i], learner.update(TIME[i], OUTPUTS[i], INPUTS[i]))
    assert view.troubles == []
    lines = drawn(path)
    assert "free_energy_of_samples" not in lines
    assert np.isnan(lines["outputs/roll/now"][1][:, :3]).all()
    assert "No model yet. There are not enough samples yet." in texts(path, "TextDocument:text")[-1]


def drawn_so_far(path: Path) -> dict:
    """As ``drawn``; nothing of a file that has not begun."""
    try:
        return drawn(path)
    except (OSError, ValueError):
        return {}


class Slow(RecordingFile):
    """A file that takes long to open: until it is let go."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.go = Event()

    def open(self, recording: rr.RecordingStream) -> bool:
        assert self.go.wait(PATIENCE)
        return super().open(recording)


def test_who_receives_does_not_wait_for_a_view_to_open(tmp_path: Path) -> None:
    sink = Slow(tmp_path / "flight.rrd")
    Timer(5.0, sink.go.set).start()  # or the old code would wait for ever
    with LiveView(CHANNELS, [sink]) as view:
        view.put(50.0, 0, OUTPUTS[0], INPUTS[0])
        assert not sink.go.is_set()
        sink.go.set()
    assert len(drawn(sink.path)["inputs"][0]) == 1


def test_a_model_outlives_the_flight_in_the_status() -> None:
    row = ViewRow(60.0, 0.0, 0, OUTPUTS[0], INPUTS[0], None, None, CHANNELS)
    status = SessionStatus(obstacle="The vehicle is on the ground.")
    assert "No model yet. The vehicle is on the ground." in status_document(CHANNELS, status, row, None, 0)
    landed = status_document(CHANNELS, status, row, 55.0, 0)
    assert "No model" not in landed and "The latest model is kept" in landed and "on the ground." in landed


@pytest.mark.slow
def test_a_row_that_cannot_be_drawn_is_reported_and_ends_nothing(tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    with LiveView(CHANNELS, [RecordingFile(path)]) as view:
        view.put(50.0, 0, OUTPUTS[0][:1], INPUTS[0])
        until(lambda: "inputs" in drawn_so_far(path) or view.put(50.1, 0, OUTPUTS[0], INPUTS[0]))
    assert view.troubles == []
    assert texts(path, "TextLog:text")[0].startswith("not drawn: ")


def test_a_full_backlog_drops_the_oldest_and_counts() -> None:
    backlog = Backlog[int](3)
    for i in range(5):
        backlog.put(i)
    assert backlog.take() == [2, 3, 4]
    assert backlog.dropped == 2
    backlog.put(5)
    assert backlog.take() == [5]
    assert backlog.dropped == 2


class Stalled(RecordingFile):
    """A sink that hangs until it is let go."""

    retried = True

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.go = Event()

    def open(self, recording: rr.RecordingStream) -> bool:
        self.go.wait()
        return super().open(recording)


@pytest.mark.slow
def test_a_stalled_sink_holds_up_nobody(tmp_path: Path) -> None:
    stalled, other = Stalled(tmp_path / "stalled.rrd"), RecordingFile(tmp_path / "other.rrd")
    known = estimate(20, 50.0)
    rows = MAX_ROWS + 1000
    with LiveView(CHANNELS, [stalled, other]) as view:
        waiting = view._threads[1].rows
        # Comes to its end, although the first sink takes nothing.
        for i in range(rows):
            view.put(50.0 + DT * i, 0, OUTPUTS[0], INPUTS[0], known)
            if i % 4000 == 3999:
                until(lambda: not waiting._items)
        assert view.dropped[stalled.name] == 1000
        assert view.dropped[other.name] == 0
        stalled.go.set()
    assert view.troubles == []
    assert len(drawn(other.path)["inputs"][0]) == rows
    times, _ = drawn(stalled.path)["inputs"]
    np.testing.assert_allclose(times, 50.0 + DT * np.arange(1000, rows), atol=1e-7)
    assert "1000 rows are not shown here: this view is too slow" in texts(stalled.path, "TextLog:text")
    assert "rows not shown | 1,000" in texts(stalled.path, "TextDocument:text")[-1]


def test_closing_twice_is_closing_once_and_nothing_comes_after(recording: Path, tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    view = LiveView(CHANNELS, [RecordingFile(path)])
    view.put(50.0, 0, OUTPUTS[0], INPUTS[0])
    view.close()
    size = path.stat().st_size
    view.close()
    view.put(50.1, 0, OUTPUTS[0], INPUTS[0])
    view.log("too late")
    view.status(SessionStatus())
    view.close()
    assert path.stat().st_size == size
    assert len(drawn(path)["inputs"][0]) == 1


def test_a_file_that_cannot_be_written_is_reported_and_ends_nothing(tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    with LiveView(CHANNELS, [RecordingFile(tmp_path / "nowhere" / "flight.rrd"), RecordingFile(path)]) as view:
        view.put(50.0, 0, OUTPUTS[0], INPUTS[0])
    (trouble,) = view.troubles
    assert "nowhere/flight.rrd cannot be written" in trouble
    assert len(drawn(path)["inputs"][0]) == 1


FLYING = """
import pathlib, resource, signal, sys, time
import numpy as np
import rerun as rr
from mavdem.view.live import Channels, LiveView, RecordingFile, Viewer, live_view, sink_thread

class File(RecordingFile):
    deliveries = 0

    def delivered(self):
        super().delivered()
        self.deliveries += 1

signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
place, rows, ending = sys.argv[1], int(sys.argv[2]), sys.argv[3]
channels = Channels("a flight", 0.01, (1, 25), ("motor 1",), ("roll", "roll rate"), ("",), ("rad", "rad/s"))
if not place.startswith("rerun"):
    live_view.CLOSE_SECONDS = sink_thread.FLUSH_SECONDS = 300.0  # a busy machine may take as long
if ending == "absent":
    rr.RecordingStream.connect_grpc = lambda *_: print("connected", flush=True)
sink = Viewer(place) if place.startswith("rerun") else File(place)
with LiveView(channels, [sink]) as view:
    for i in range(rows):
        view.put(0.01 * i, 0, [i, 0.0], [0.0])
        print(i, flush=True)
        time.sleep(0.002)
        if ending == "full" and i == rows - 100:
            while view._threads[0].rows._items:
                time.sleep(0.01)
            written = sink.deliveries
            while sink.deliveries == written:
                time.sleep(0.01)
            full = pathlib.Path(place).stat().st_size + 3000
            resource.setrlimit(resource.RLIMIT_FSIZE, (full, full))
    if ending == "error":
        raise ValueError("a mistake")
print("closed", view.troubles, flush=True)
"""


class Flying:
    """A process that flies; what it prints is in ``printed``."""

    def __init__(self, folder: Path, place: str | Path, rows: int, ending: str = "") -> None:
        self._words, self._errors = (folder / f"{ending or 'flight'}.{kind}" for kind in ("out", "err"))
        with self._words.open("w") as words, self._errors.open("w") as errors:
            command = [sys.executable, "-c", FLYING, str(place), str(rows), ending]
            self.process = subprocess.Popen(command, stdout=words, stderr=errors)

    @property
    def printed(self) -> list[str]:
        return self._words.read_text().splitlines()

    @property
    def errors(self) -> str:
        return self._errors.read_text()

    @property
    def rows(self) -> int:
        return sum(line.isdecimal() for line in self.printed)


@pytest.mark.slow
def test_a_flight_that_is_ended_or_fails_leaves_all_its_rows(tmp_path: Path) -> None:
    # All at once, since each takes a second to begin.
    signals = [signal.SIGINT, signal.SIGTERM]
    flights = {number: Flying(tmp_path, tmp_path / f"{number.name}.rrd", 100_000, number.name) for number in signals}
    failing = Flying(tmp_path, tmp_path / "error.rrd", 100, "error")
    for number, flight in flights.items():
        until(lambda flight=flight: flight.rows > 100)
        flight.process.send_signal(number)
        flight.process.wait(PATIENCE)
        values = drawn(tmp_path / f"{number.name}.rrd")["outputs/roll/now"][1][:, 3]
        # One may have been put and not printed.
        assert len(values) - flight.rows in (0, 1)
        np.testing.assert_allclose(values, np.degrees(np.arange(len(values))))
    failing.process.wait(PATIENCE)
    assert "a mistake" in failing.errors
    assert len(drawn(tmp_path / "error.rrd")["inputs"][0]) == 100


def rows_so_far(path: Path) -> int:
    """Rows in a file that another process writes; 0 while its end is torn."""
    with suppress(Exception):
        return len(drawn(path)["inputs"][0])
    return 0


@pytest.mark.slow
def test_a_killed_process_or_a_full_disk_leaves_a_file_that_opens(tmp_path: Path) -> None:
    killed = Flying(tmp_path, tmp_path / "killed.rrd", 100_000, "killed")
    full = Flying(tmp_path, tmp_path / "full.rrd", 600, "full")
    written = until(lambda: rows_so_far(tmp_path / "killed.rrd"))
    killed.process.kill()
    killed.process.wait(PATIENCE)
    assert written <= len(drawn(tmp_path / "killed.rrd")["inputs"][0]) <= killed.rows + 1
    full.process.wait(PATIENCE)
    assert "full.rrd failed" in full.printed[-1]
    assert len(drawn(tmp_path / "full.rrd")["inputs"][0]) == 501


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.mark.slow
def test_a_viewer_that_is_not_there_delays_nothing(tmp_path: Path) -> None:
    flight = Flying(tmp_path, f"rerun+http://127.0.0.1:{free_port()}/proxy", 500, "absent")
    assert flight.process.wait(PATIENCE) == 0
    assert flight.rows == 500
    # Rerun's own client would wait for ten seconds at the end.
    assert "connected" not in flight.printed
    closed = flight.printed[-1]
    assert "there is no viewer at rerun+http" in closed


@pytest.mark.parametrize("url", ["", "127.0.0.1:9876", "http://127.0.0.1:9876/proxy", "rerun+http://:1/proxy"])
def test_an_address_of_another_form_is_refused(url: str) -> None:
    with pytest.raises(ValueError, match="looks like rerun\\+http://127.0.0.1:9876/proxy"):
        Viewer(url)


def test_without_a_screen_something_must_be_asked_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ValueError, match="There is no screen here: use --rrd FILE to record, or --serve"):
        sinks_for()
    (file,) = sinks_for(rrd=tmp_path / "flight.rrd")
    assert isinstance(file, RecordingFile)
    (viewer,) = sinks_for(connect="rerun+http://127.0.0.1:1/proxy")
    assert isinstance(viewer, Viewer)


def listening(server: WebServer) -> set[tuple[str, int]]:
    own = psutil.Process(server.process.pid)
    return {
        tuple(connection.laddr)
        for process in (own, *own.children(recursive=True))
        for connection in process.net_connections("inet")
        if connection.status == psutil.CONN_LISTEN
    }


def until(happens):
    """What ``happens`` answers, as soon as it is something."""
    deadline = time.monotonic() + PATIENCE
    while not (answer := happens()):
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.05)
    return answer


@pytest.mark.slow
def test_the_server_is_reached_from_this_machine_only() -> None:
    port, page_port = free_port(), free_port()
    server = WebServer(port, page_port)
    with LiveView(CHANNELS, [server]) as view:
        sockets = until(lambda: len(listening(server)) == 2 and listening(server))
        assert sockets == {("127.0.0.1", port), ("127.0.0.1", page_port)}
        for i in range(100):
            view.put(TIME[i], 0, OUTPUTS[i], INPUTS[i])
        until(lambda: not view.troubles)
        with urllib.request.urlopen(server.page) as page:
            assert b"rerun" in page.read().lower()
        # In a notebook, Rerun's page reports nothing to Rerun.
        assert parse_qs(urlsplit(server.page).query)["notebook"] == ["1"]
        with pytest.raises(OSError, match=f"port {port} of 127.0.0.1 is taken"):
            WebServer(port, page_port)
    assert server.process.poll() is not None


SERVING = """
import sys, time
from mavdem.view.live import WebServer
server = WebServer(*map(int, sys.argv[1:]))
time.sleep(3600)
"""


def taken(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.mark.slow
def test_the_server_ends_with_who_started_it_however_that_ends_and_reports_to_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ports = free_port(), free_port()
    unset = ("CI", "XDG_CONFIG_HOME", "XDG_DATA_HOME")
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    environment |= {"HOME": str(tmp_path), "FORCE_RERUN_ANALYTICS": "1"}
    with subprocess.Popen([sys.executable, "-c", SERVING, *map(str, ports)], env=environment) as owner:
        until(lambda: all(map(taken, ports)))
        # What reports begins with a file that says who it is.
        assert not [path for path in tmp_path.rglob("*") if path.is_file()]
        owner.kill()
    until(lambda: not any(map(taken, ports)))


@pytest.mark.slow
def test_a_file_gets_its_table_without_a_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("CI", "XDG_CONFIG_HOME", "XDG_DATA_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    with LiveView(CHANNELS, [RecordingFile(tmp_path / "flight.rrd")]) as view:
        view.put(50.0, 0, OUTPUTS[0], INPUTS[0])
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["flight.rrd"]
    assert RrdReader(tmp_path / "flight.rrd").store() is not None


def serving(port: int) -> subprocess.Popen[bytes]:
    """A server without a window."""
    silent = subprocess.DEVNULL
    command = [sys.executable, "-m", "rerun", "--serve-grpc", "--bind", "127.0.0.1", "--port", str(port)]
    return subprocess.Popen(command, start_new_session=True, stdout=silent, stderr=silent)


@pytest.mark.slow
def test_a_viewer_that_comes_goes_and_comes_again_is_shown_what_it_can_be() -> None:
    port = free_port()
    with LiveView(CHANNELS, [Viewer(f"rerun+http://127.0.0.1:{port}/proxy")]) as view:

        def put_and(wanted):
            view.put(time.monotonic(), 0, OUTPUTS[0], INPUTS[0])
            return wanted()

        until(lambda: put_and(lambda: "there is no viewer" in "".join(view.troubles)))
        for _ in range(2):
            viewer = serving(port)
            until(lambda: put_and(lambda: not view.troubles))
            os.killpg(viewer.pid, signal.SIGKILL)
            viewer.wait()
            until(lambda: put_and(lambda: view.troubles))
        began = time.monotonic()
    # It waits for nobody who is gone.
    assert time.monotonic() - began < PATIENCE / 2


@pytest.mark.slow
def test_a_viewer_that_hangs_holds_up_the_end_for_seconds_only(tmp_path: Path) -> None:
    port = free_port()
    viewer = serving(port)
    try:
        until(lambda: not socket.socket().connect_ex(("127.0.0.1", port)))
        flight = Flying(tmp_path, f"rerun+http://127.0.0.1:{port}/proxy", 600)
        until(lambda: flight.rows > 300)
        os.killpg(viewer.pid, signal.SIGSTOP)
        assert flight.process.wait(PATIENCE) == 0
        assert "does not respond" in flight.printed[-1]
    finally:
        os.killpg(viewer.pid, signal.SIGKILL)
        viewer.wait()
