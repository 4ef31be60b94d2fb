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
from types import SimpleNamespace
from urllib.parse import parse_qs, urlsplit

import numpy as np
import psutil
import pytest
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import RrdReader
from rerun_file import chunks, layouts, views

import mavdem
from mavdem.dem import Estimate, LinearModel
from mavdem.health.motor_watch import MotorAlarm
from mavdem.live import SessionStatus
from mavdem.view.live import Channels, LiveView, RecordingFile, Viewer, WebServer, sinks_for
from mavdem.view.live.figures import figures, status_document
from mavdem.view.live.line_group import LineGroup
from mavdem.view.live.live_view import REBOOT_GAP_SECONDS, Timeline
from mavdem.view.live.rows import ViewRow
from mavdem.view.live.sink_thread import MAX_ROWS, Backlog

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
FIGURES = {f"figures/{i}" for i in range(4)}
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
def test_outputs_and_predictions_a_quarter_of_a_second_ahead_are_in_degrees_at_their_times(
    recording: Path, column: int, name: str
) -> None:
    lines = drawn(recording)
    times, values = lines[f"outputs/{name}/1_measured"]
    np.testing.assert_allclose(times, TIME, atol=1e-8)
    np.testing.assert_allclose(values[:, 0], np.degrees(OUTPUTS[:, column]))
    times, values = lines[f"outputs/{name}/2_predicted"]
    np.testing.assert_allclose(times, TIME + 25 * DT, atol=1e-8)
    assert np.isnan(values[:20]).all()
    centre, half = (np.array([getattr(e, part)[1, column] for e in TOLD]) for part in ("ahead", "ahead_band"))
    measured = np.degrees(OUTPUTS[:, column])
    beyond = 0.3 * np.ptp(measured)
    sight = measured.min() - beyond, measured.max() + beyond
    np.testing.assert_allclose(values[20:, 0], np.clip(np.degrees(centre), *sight))
    times, edges = lines[f"outputs/{name}/0_band"]
    np.testing.assert_allclose(times, np.repeat(TIME + 25 * DT, 2), atol=1e-8)
    expected = np.clip(np.degrees([centre - half, centre + half]), *sight)
    np.testing.assert_allclose(edges[40:, 0], expected.T.ravel())


@pytest.mark.slow
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
        times, values = drawn(path)["outputs/roll/2_predicted"]
        place = HORIZONS.index(useful)
        np.testing.assert_allclose(times, [told.ahead_times[place]])
        np.testing.assert_allclose(values[0, 0], np.degrees(told.ahead[place, 0]))
        assert f"{useful * DT:.2g} s ahead" in named


@pytest.mark.slow
def test_the_command_is_that_of_the_weights_or_else_every_motor(recording: Path, tmp_path: Path) -> None:
    times, values = drawn(recording)["command"]
    np.testing.assert_allclose(times, TIME, atol=1e-8)
    np.testing.assert_array_equal(values, INPUTS)
    weights = (0.5, -0.5, -0.5, 0.5)
    path = tmp_path / "flight.rrd"
    with LiveView(CHANNELS._replace(command=weights), [RecordingFile(path)]) as view:
        view.put(TIME[0], 0, OUTPUTS[0], INPUTS[0])
    np.testing.assert_allclose(drawn(path)["command"][1], [[INPUTS[0] @ weights]])


def test_each_alarm_is_marked_once_also_where_the_status_keeps_the_latest_only(monkeypatch) -> None:
    alarms = [MotorAlarm(at + 2.0, at, 1, "motor 1", 0.2, 0.99) for at in range(5)]
    marked: list[float] = []
    with LiveView(CHANNELS, []) as view:
        monkeypatch.setattr(view, "_log", lambda shown, level, text: marked.append(shown))
        for count in (1, 3, 3, 4, 5):
            view.status(SessionStatus(alarms=tuple(alarms[:count][-2:]), alarm_count=count))
    assert marked == [0, 1, 2, 3, 4]


def test_what_is_judged_is_at_the_times_it_is_about(recording: Path) -> None:
    lines = drawn(recording)
    seen = np.array([e.seen for e in TOLD])
    surprise = np.array([e.surprise for e in TOLD])
    expected = {
        "free_energy_of_samples": np.array([[e.free_energy] for e in TOLD]),
        "surprise/samples": np.stack([np.ones(len(TOLD)), surprise], axis=-1),
    }
    for path, values in expected.items():
        np.testing.assert_allclose(lines[path][0], seen, atol=1e-8)
        np.testing.assert_allclose(lines[path][1], values)
    unusual = np.array([e.unusual for e in TOLD])
    np.testing.assert_allclose(lines["surprise/unusual"][0], seen[unusual], atol=1e-8)
    np.testing.assert_allclose(lines["surprise/unusual"][1][:, 0], surprise[unusual])


def test_the_wind_s_torque_is_drawn_with_its_band_when_it_acted(recording: Path) -> None:
    times, values = drawn(recording)["wind/1_torque"]
    np.testing.assert_allclose(times, TIME[20:] - 0.25, atol=1e-8)
    np.testing.assert_allclose(values[20:, 0], np.degrees(0.1 * np.arange(40, 300)))
    assert np.isnan(values[:20]).all()
    times, edges = drawn(recording)["wind/0_band"]
    np.testing.assert_allclose(times, np.repeat(TIME[20:] - 0.25, 2), atol=1e-8)
    half = np.degrees(0.01 * np.arange(100, 200))
    np.testing.assert_allclose(edges[161:360:2, 0] - edges[160:360:2, 0], 2 * half)


@pytest.mark.slow
def test_what_happens_is_logged_with_its_time_and_size(tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    torque = np.random.default_rng(1).normal(size=4000)
    torque[3200:3250] = 20.0
    with LiveView(CHANNELS, [RecordingFile(path)]) as view:
        for i, one in enumerate(torque):
            now = estimate(20, 50.0 + DT * i)
            now = now._replace(wind_torque=one, wind_torque_band=0.5, unusual=3500 <= i < 3600, surprise=7.0)
            view.put(now.time, 0, OUTPUTS[0], INPUTS[0], now)
    assert sorted(texts(path, "TextLog:text")) == ["gust: +1149 °/s² for 0.5 s", "unusual motion: surprise 7"]
    stamps = [np.array(batch.column("boot clock").cast("int64")) for name, _, batch in chunks(path) if name == "log"]
    times = np.concatenate(stamps) / 1e9
    assert sorted(times) == pytest.approx([81.75, 85.0 - LATE], abs=0.02)


def test_a_model_is_drawn_once(recording: Path) -> None:
    times, values = drawn(recording)["free_energy_action"]
    np.testing.assert_allclose(times, TIME[20::10], atol=1e-8)
    np.testing.assert_allclose(values[:, 0], [-1000.0 - i for i in range(2, 30)])


def test_log_and_status_show_what_they_were_given(recording: Path) -> None:
    found = zip(texts(recording, "TextLog:text"), texts(recording, "TextLog:level"), strict=True)
    said = [(text, level) for text, level in found if "unusual" not in text]
    assert said == [("attached", "INFO"), ("link lost", "WARN")]
    document = texts(recording, "TextDocument:text")[-1]
    for fact in (CHANNELS.title, "300 at 100 Hz", "99.4 Hz", "frames lost | 7", "12 ms", "The motors hardly move."):
        assert fact in document
    assert "learned up to 0.1 s ago" in document


def test_batches_are_not_tiny(recording: Path) -> None:
    sizes = [batch.num_rows for name, _, batch in chunks(recording) if name.startswith(("outputs", "command"))]
    assert np.mean(sizes) >= 100


def test_the_blueprint_shows_what_is_there(recording: Path) -> None:
    shown = views(recording)
    assert len(shown) == 16
    entities = {name for name, *_ in chunks(recording)}
    learned = {"noise_precisions", "parameters/A", "parameters/B"}  # drawn from the first batch of learning on
    for origin in set(shown) - learned:
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
    np.testing.assert_allclose(lines["outputs/roll/1_measured"][1][:, 0], np.degrees(flight.outputs[:, 0]))
    assert len(lines["free_energy_of_samples"][0]) > 80
    # Of a rate and a hidden lag, and the motors' effect on both; that a rate is a rate is known beforehand.
    widths = {name: values.shape[1] for name, (_, values) in lines.items() if name.startswith(("param", "noise"))}
    assert widths == {"parameters/A": 3, "parameters/B": 8, "noise_precisions": 1}


@pytest.mark.slow
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
    np.testing.assert_array_equal(lines["command"][1], INPUTS[[0, 1, 5]])
    np.testing.assert_array_equal(lines["setup_2/command"][1], INPUTS[2:5, :1])
    np.testing.assert_allclose(lines["outputs/roll/1_measured"][1][:, 0], np.degrees(OUTPUTS[[0, 1, 5], 0]))
    np.testing.assert_allclose(lines["setup_2/outputs/roll/1_measured"][1][:, 0], OUTPUTS[2:5, 0])
    np.testing.assert_allclose(lines["setup_2/outputs/roll/2_predicted"][0], TIME[2:5] + 0.25)
    assert "setup_2/free_energy_action" in lines
    assert sum("other channels" in text for text in texts(path, "TextLog:text")) == 2
    # Three blueprints are sent; a file does not tell in which order.
    first, third, second = sorted(map(set, layouts(path)), key=lambda origins: "setup_2/command" in origins)
    assert first == third != second and first & second == {"status", "log", *FIGURES}
    shown = {origin for origin in second if any(f"{name}/".startswith(f"{origin}/") for name in lines)}
    learned = {f"setup_2/{name}" for name in ("noise_precisions", "parameters/A", "parameters/B")}
    assert second - shown == {"status", "log", *FIGURES, *learned}


@pytest.mark.slow
def test_a_missing_stretch_parts_every_line(tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    with LiveView(CHANNELS, [RecordingFile(path)]) as view:
        for i in range(20):
            view.put(50.0 + DT * i + (i >= 10), int(i >= 10), OUTPUTS[i], INPUTS[i], estimate(20 + i, 50.0 + DT * i))
    lines = drawn(path)
    for name, width in (("command", 4), ("outputs/roll/1_measured", 1), ("outputs/roll/2_predicted", 1)):
        times, values = lines[name]
        assert np.isnan(values[10]).all() and np.isfinite(np.delete(values, 10, axis=0)).all()
        assert values.shape == (21, width)
        assert times[9] < times[10] < times[11]


@pytest.mark.slow
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
    times = lines["command"][0]
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


@pytest.mark.slow
def test_what_is_not_known_is_left_out(tmp_path: Path) -> None:
    learner = mavdem.OnlineLearner(dt=DT)
    path = tmp_path / "flight.rrd"
    with LiveView(CHANNELS, [RecordingFile(path)]) as view:
        for i in range(20):
            view.put(TIME[i], 0, OUTPUTS[i], INPUTS[i], learner.update(TIME[i], OUTPUTS[i], INPUTS[i]))
    assert view.troubles == []
    lines = drawn(path)
    assert "free_energy_of_samples" not in lines
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


@pytest.mark.slow
def test_who_receives_does_not_wait_for_a_view_to_open(tmp_path: Path) -> None:
    sink = Slow(tmp_path / "flight.rrd")
    Timer(5.0, sink.go.set).start()  # or the old code would wait for ever
    with LiveView(CHANNELS, [sink]) as view:
        view.put(50.0, 0, OUTPUTS[0], INPUTS[0])
        assert not sink.go.is_set()
        sink.go.set()
    assert len(drawn(sink.path)["command"][0]) == 1


def test_four_figures_are_shown_as_soon_as_they_are_known() -> None:
    row = ViewRow(60.0, 0.0, 0, OUTPUTS[0], INPUTS[0], None, None, CHANNELS)
    status = SessionStatus(obstacle="The vehicle is on the ground.")
    state, error, *others = figures(CHANNELS, status, row, None)
    assert "waiting, 0 s learned\nThe vehicle is on the ground." in state
    assert all("### –" in figure for figure in (error, *others))
    now = estimate(60, 60.0)._replace(
        physical=SimpleNamespace(
            mean_effect=lambda level: (0.1, 0.01), damping=3.0, interval=lambda level: SimpleNamespace(damping=np.nan)
        )
    )
    status = SessionStatus(learned=4200, ahead=(0.25, np.radians(2.0)), useful=(0.5, 0.41))
    shown = "\n".join(figures(CHANNELS, status, row._replace(estimate=now), 59.0))
    for words in (
        "learning, 42 s learned",
        "± 2.0°\n0.25 s ahead (90 %); error ratio 0.41 at 0.5 s",
        "340 ± 30 °/s²",
        "5.7 ± 0.6 °/s² per µs\ndamping not identifiable",
    ):
        assert words in shown


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
        until(lambda: "command" in drawn_so_far(path) or view.put(50.1, 0, OUTPUTS[0], INPUTS[0]))
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
    assert len(drawn(other.path)["command"][0]) == rows
    times, _ = drawn(stalled.path)["command"]
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
    assert len(drawn(path)["command"][0]) == 1


@pytest.mark.slow
def test_a_file_that_cannot_be_written_is_reported_and_ends_nothing(tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    with LiveView(CHANNELS, [RecordingFile(tmp_path / "nowhere" / "flight.rrd"), RecordingFile(path)]) as view:
        view.put(50.0, 0, OUTPUTS[0], INPUTS[0])
    (trouble,) = view.troubles
    assert "nowhere/flight.rrd cannot be written" in trouble
    assert len(drawn(path)["command"][0]) == 1


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
        values = drawn(tmp_path / f"{number.name}.rrd")["outputs/roll/1_measured"][1][:, 0]
        # One may have been put and not printed.
        assert len(values) - flight.rows in (0, 1)
        np.testing.assert_allclose(values, np.degrees(np.arange(len(values))))
    failing.process.wait(PATIENCE)
    assert "a mistake" in failing.errors
    assert len(drawn(tmp_path / "error.rrd")["command"][0]) == 100


def rows_so_far(path: Path) -> int:
    """Rows in a file that another process writes; 0 while its end is torn."""
    with suppress(Exception):
        return len(drawn(path)["command"][0])
    return 0


@pytest.mark.slow
def test_a_killed_process_or_a_full_disk_leaves_a_file_that_opens(tmp_path: Path) -> None:
    killed = Flying(tmp_path, tmp_path / "killed.rrd", 100_000, "killed")
    full = Flying(tmp_path, tmp_path / "full.rrd", 600, "full")
    written = until(lambda: rows_so_far(tmp_path / "killed.rrd"))
    killed.process.kill()
    killed.process.wait(PATIENCE)
    assert written <= len(drawn(tmp_path / "killed.rrd")["command"][0]) <= killed.rows + 1
    full.process.wait(PATIENCE)
    assert "full.rrd failed" in full.printed[-1]
    assert len(drawn(tmp_path / "full.rrd")["command"][0]) == 501


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
