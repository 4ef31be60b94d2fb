"""A flight under way reaches a recording sample for sample, and nothing that shows it holds up who learns from it."""

import os
import socket
import subprocess
import sys
import urllib.request
from contextlib import closing, contextmanager
from dataclasses import replace
from threading import Event
from uuid import uuid4

import numpy as np
import psutil
import rerun as rr
from numpy.random import default_rng
from numpy.testing import assert_allclose
from partial_records import partial_record
from patience import PATIENCE, until
from pytest import MonkeyPatch, approx, fail, fixture, mark, raises
from refusals import prose
from rerun_file import chunks, drawn, views

from mavdem.dem import Estimate, LinearModel
from mavdem.facts import Level
from mavdem.facts.identifiability import Status
from mavdem.facts.session import SessionFact
from mavdem.live import Event as Occurrence
from mavdem.live import SessionStatus
from mavdem.live.display import DisplayRow
from mavdem.live.session_state import Latency, PredictionBand, UsefulHorizon
from mavdem.live.stream import LatestPose
from mavdem.live.wind import WindEstimate
from mavdem.motors.motor_changes import MotorChange
from mavdem.plant import Physical
from mavdem.plant.online_wind_torque import is_torque_resolved
from mavdem.plant.sampled_plant import GAUSSIAN_KERNEL, WindComponent
from mavdem.report.live import headline_and_next_step
from mavdem.view.live_content import Channels, current_value_texts, status_document
from mavdem.view.live_view import LiveView, SinkThread
from mavdem.view.sinks import RecordingFile, Viewer, WebServer, requested_sinks

pytestmark = mark.slow

DT = 0.01
HORIZONS = (1, 25, 50)
MOTORS = tuple(f"motor {i} (somewhere)" for i in range(1, 5))
UNITS = ("µs",) * 4, ("rad", "rad/s")
CHANNELS = Channels(
    "vehicle 1 on udpin:127.0.0.1:14550", DT, HORIZONS, MOTORS, ("roll", "roll rate"), *UNITS
)
LATE = 0.04  # Seconds from the centre of a window to its end


def model(seed):
    sizes = (3, 3), (3, 4), (2, 3), (3,), (4,), (2,)
    return LinearModel(*(default_rng(seed).uniform(0.1, 1.0, size) for size in sizes))


# The half width of a 90 % interval is 1.645 standard deviations: that of the effect is 0.01.
PHYSICAL = partial_record(
    Physical,
    effect=np.array([0.1]),
    damping=3.0,
    lag=0.02,
    components=(WindComponent(GAUSSIAN_KERNEL, 9.0, 0.2),),
    covariance=np.diag([(0.01 / 1.645) ** 2, 1.0, 1e-6, 1e-6]),
    status={
        "effect": Status.REPORTED,
        "damping": Status.NOT_IDENTIFIABLE,
        "lag": Status.REPORTED,
    },
)


def estimate(i, time):
    """All its numbers differ, and differ from those of other samples."""
    rng = default_rng(i)
    return Estimate(
        time=time,
        window_center=time - LATE,
        training_end_time=time - 0.1,
        wind_time=time - 0.25,
        free_energy=-100.0 - i,
        free_energy_terms=np.arange(10.0) - i,
        free_energy_action=-1000.0 - i,
        physical=PHYSICAL,
        surprise=i % 50 / 10,
        unusual=i % 50 == 40,
        model=MODELS[i // 10],
        wind_torque=np.nan if i < 40 else 0.1 * i,
        wind_torque_band=0.01 * i,
        expected=rng.normal(size=2),
        expected_band=rng.normal(size=2),
        ahead=rng.normal(size=(3, 2)),
        ahead_band=rng.normal(size=(3, 2)),
        ahead_times=time + DT * np.array(HORIZONS),
        ahead_ratio=np.array([[0.1, 0.2], [0.3, 0.4], [0.7, 0.8]]),
    )


MODELS = [model(seed) for seed in range(40)]
TIME = 50.0 + DT * np.arange(300)
OUTPUTS = default_rng(1).normal(size=(300, 2))
INPUTS = default_rng(2).uniform(1000, 2000, size=(300, 4))
ESTIMATES = [None if i < 20 else estimate(i, t) for i, t in enumerate(TIME)]
WIND = WindEstimate(59.25, np.array([3.0, -4.0]), np.array([0.5, 0.5]))
ROW = DisplayRow(50.0, 0.0, 0, OUTPUTS[0], INPUTS[0])


def texts(path, column="TextLog:text"):
    """The texts of the log or of the status, in the order of their times."""
    dated = []
    for name, _, batch in chunks(path):
        if column in batch.schema.names and name not in ("figures", "events"):
            times = batch.column("boot clock").cast("int64").to_pylist()
            dated += zip(times, (text for (text,) in batch.column(column).to_pylist()), strict=True)
    return [text for _, text in sorted(dated, key=lambda pair: pair[0])]


@contextmanager
def showing(*sinks, channels=CHANNELS):
    with closing(LiveView(sinks)) as view:
        view.change(channels)
        yield view


@fixture(scope="module", autouse=True)
def patience():
    """A file is waited for as long as a busy machine takes."""
    with MonkeyPatch.context() as patch:
        for name in ("CLOSING_SECONDS", "FLUSH_SECONDS"):
            patch.setattr(f"mavdem.view.live_view.{name}", PATIENCE)
        yield


@fixture(scope="module")
def recording(tmp_path_factory):
    """A recording of a live view: a short flight with estimates, between two events."""
    path = tmp_path_factory.mktemp("live") / "flight.rrd"
    rates = {"ATTITUDE": 99.4}
    file = RecordingFile(path)
    with showing(file) as view:
        view.log(Occurrence(50.0, prose("attached")))
        view.status(
            SessionStatus(
                rates=rates,
                lost_messages=7,
                latency=Latency(0.012, 0.02),
                learned_rows=300,
                no_model_reason=prose("No motion."),
            )
        )
        for t, y, u, model_estimate in zip(TIME, OUTPUTS, INPUTS, ESTIMATES, strict=True):
            position = (t, 2.0, -5.0)
            pose = LatestPose(t, (y[0], 0.1, 0.2), (y[1], 0.3, 0.4), (0.5, np.nan), position)
            wind = replace(WIND, time=round(t, 1))
            view.put(DisplayRow(t, 0.0, 0, y, u, model_estimate, None, wind, pose))
        view.log(Occurrence(TIME[-1], prose("link lost")))
    assert view.problems == [] and not file.is_broken
    assert b"FOOT" in path.read_bytes()[-12:]  # The file ends with the table of its chunks.
    return path


def test_log_status_and_blueprint_show_what_is_there_in_batches_that_are_not_tiny(recording):
    """Each view of the layout has entities with samples, which are sent in batches."""
    assert [text for text in texts(recording) if "unusual" not in text] == [
        "attached.",
        "link lost.",
    ]
    assert_allclose(drawn(recording)["axes/roll/0_asked"][1], np.degrees(0.5))
    document = texts(recording, "TextDocument:text")[-1]
    assert CHANNELS.title in document and "No motion." in document
    vehicle_batches = [
        batch for name, _, batch in chunks(recording) if name == "world/here/vehicle"
    ]
    assert sum(batch.num_rows for batch in vehicle_batches) >= 9 * (TIME[-1] - TIME[0])
    entities = {name: batch.num_rows for name, _, batch in chunks(recording)}
    lines = (
        "axes/pitch/1_measured",
        "axes/roll/1_measured",
        "axes/roll/2_predicted",
        "motors/0_outputs",
    )
    assert min(entities[name] for name in lines) >= 100
    assert {"axes/roll", "free_energy", "parameters", "air", "wind"} <= set(views(recording))
    for origin in set(views(recording)):
        assert any(f"{entity}/".startswith(f"{origin}/") for entity in entities), (
            f"the view of {origin} is empty"
        )


def test_an_alarm_is_an_error_in_the_log_and_marks_its_beginning_in_every_plot(
    tmp_path,
):
    """One alarm of each kind is shown: by its text, and by a vertical line in every plot."""
    path = tmp_path / "flight.rrd"
    with showing(RecordingFile(path)) as view:
        for t, y, u, model_estimate in zip(TIME, OUTPUTS, INPUTS, ESTIMATES, strict=True):
            view.put(DisplayRow(t, 0.0, 0, y, u, model_estimate))
        alarm = prose("Alarm: motor 1 lost some thrust.").replace(Level.BAD)
        view.log(Occurrence(52.9, alarm, 51.25))
        lost = MotorChange(52.9, 52.0, 0, "motor 1", 0.2, 0.99, loss=(0.1, 0.3))
        view.log(Occurrence(52.95, lost.event, lost.onset_time))
    marks = {name: line for name, line in drawn(path).items() if name.endswith("alarms")}
    plots = {"axes/roll", "free_energy", "motors", "surprise", "wind"}
    assert plots <= {name.removesuffix("/9_alarms") for name in marks}
    for times, values in marks.values():
        assert_allclose(np.unique(times[np.isfinite(values[:, 0])]), [51.25, 52.0])
        assert np.nanmin(values) < np.nanmax(values)
    times, _ = drawn(path)["wind/2_motor"]
    assert times.min() == approx(52.0, abs=DT), "its torque is no wind"
    levels = dict(zip(texts(path), texts(path, "TextLog:level"), strict=True))
    assert levels.pop("Alarm: motor 1 lost some thrust.") == "ERROR"
    assert set(levels.values()) <= {"INFO", "ERROR"}


def test_a_wind_torque_smaller_than_its_error_is_not_identifiable():
    assert is_torque_resolved(PHYSICAL, 5.0)
    assert not is_torque_resolved(PHYSICAL, 12.0)
    unknown = PHYSICAL._replace(status={**PHYSICAL.status, "effect": Status.NOT_IDENTIFIABLE})
    assert not is_torque_resolved(unknown, 5.0)
    row = ROW._replace(estimate=estimate(60, 60.0)._replace(wind_torque_band=12.0))
    assert (
        "not identifiable\nsmaller than its error of ± 688 °/s²"
        in current_value_texts(SessionStatus(), row, CHANNELS, 59.0)[3]
    )


def test_parameters_and_surprises_are_drawn_and_axes_have_three_ticks(recording):
    """The lines of the recording have the values of the estimates, in degrees."""
    lines = drawn(recording)
    effect, lag = (lines[f"parameters/{number}_line"][1] for number in (3, 5))
    # 0.1 rad/s² is 5.7 °/s², in units of ten; what is not identifiable is not drawn.
    assert_allclose([effect[0, 0], lag[0, 0]], [0.573, 2.0], rtol=1e-3)
    assert "parameters/4_line" not in lines
    half_width = np.ptp(lines["parameters/0_band"][1][:2]) / 2
    assert half_width == approx(0.0573, rel=1e-3)
    surprise_times = [
        model_estimate.window_center
        for model_estimate in ESTIMATES
        if model_estimate is not None and model_estimate.unusual
    ]
    times, values = lines["axes/roll/8_surprises"]
    assert_allclose(np.unique(times[np.isfinite(values[:, 0])]), surprise_times, atol=1e-8)
    for plot in ("axes/roll", "motors", "parameters", "air", "wind"):
        low, high = lines[f"{plot}/90_axis"][1][-1]
        assert high - low >= 2 * 10.0 ** np.floor(np.log10((high - low) / 2))


def test_other_channels_continue_the_lines_under_their_own_names(tmp_path):
    """The inputs change from four motors to the demand and back: the other lines go on."""
    path = tmp_path / "flight.rrd"
    demand = CHANNELS._replace(
        dt=0.02, horizons=(1, 12, 50), input_names=("roll demand",), input_units=("",)
    )
    with showing(RecordingFile(path)) as view:
        for i, channels in enumerate([CHANNELS, CHANNELS, demand, demand, demand, CHANNELS]):
            view.change(channels)
            inputs = INPUTS[i][: len(channels.input_names)]
            row = DisplayRow(TIME[i], 0.0, 0, OUTPUTS[i], inputs, estimate(20 + i, TIME[i]))
            view.put(
                row._replace(
                    pose=LatestPose(TIME[i], (0.0, 0.0, 0.0), (), (0.0, 0.0), (0.2 * i, 0.0, 0.0))
                )
            )
    (north,) = [batch for name, _, batch in chunks(path, static=True) if name == "world/north"]
    assert north.num_rows == 1  # The 3D tab is drawn once, and its path continues.
    rows = [
        batch.column("Scalars:scalars").to_pylist()
        for name, _, batch in chunks(path)
        if name == "motors/0_outputs"
    ]
    assert sorted(len(values) for batch in rows for values in batch) == [1, 1, 1, 4, 4, 4]
    lines = drawn(path, ignored="motors/0_outputs")
    assert_allclose(lines["axes/roll/1_measured"][1][:, 0], np.degrees(OUTPUTS[:6, 0]))
    assert_allclose(lines["axes/roll/2_predicted"][0][2:5], TIME[2:5] + 0.25)


def test_a_gap_parts_every_line_and_time_goes_on_where_a_reboot_sets_the_clock_back(tmp_path):
    """Three segments follow each other. The third is after a reboot, whose clock is 498 s behind."""
    path = tmp_path / "flight.rrd"
    with showing(RecordingFile(path)) as view:
        for segment, (start, shift) in enumerate(((498.9, 0.0), (500.0, 0.0), (3.0, 498.0))):
            for i in range(10):
                time = start + DT * i
                view.put(
                    DisplayRow(time, shift, segment, OUTPUTS[i], INPUTS[i], estimate(20, time))
                )
    lines = drawn(path)
    ten = DT * np.arange(10)
    timeline_times = np.concatenate([498.9 + ten, 500.0 + ten, 501.0 + ten])
    for name, width in (
        ("motors/0_outputs", 4),
        ("axes/roll/1_measured", 1),
        ("axes/roll/2_predicted", 1),
    ):
        times, values = lines[name]
        assert (
            values.shape == (32, width)
            and np.isnan(values[[10, 21]]).all()
            and (np.diff(times) > 0).all()
        )
    assert_allclose(np.delete(lines["motors/0_outputs"][0], [10, 21]), timeline_times, atol=1e-8)
    assert_allclose(lines["free_energy/0_samples"][0], timeline_times - LATE, atol=1e-8)
    assert "boot clock: 3.1 s" in texts(path, "TextDocument:text")[-1]


class Held(RecordingFile):
    """A sink that does not open until it is let go."""

    is_retried = True

    def __init__(self, path):
        super().__init__(path)
        self.go = Event()

    def open(self, recording):
        assert self.go.wait(PATIENCE)
        return super().open(recording)


def test_a_stalled_sink_holds_up_nobody_and_loses_the_oldest_rows_only(tmp_path, monkeypatch):
    """One of two files hangs: it loses 100 of 300 rows, the other none."""
    monkeypatch.setattr("mavdem.view.live_view.MAX_SAMPLES", 200)
    stalled = Held(tmp_path / "stalled.rrd")
    other = RecordingFile(tmp_path / "other.rrd")
    model_estimate = estimate(20, 50.0)
    other.period = 0.01
    rows = 300
    with showing(stalled, other) as view:
        waiting = view._threads[1]._rows
        # Comes to its end, although the first sink takes nothing.
        for i in range(rows):
            view.put(ROW._replace(time=50.0 + DT * i, estimate=model_estimate))
            if i % 100 == 99:
                until(lambda: not waiting)
        assert [thread.dropped_rows for thread in view._threads] == [100, 0]
        stalled.go.set()
    assert view.problems == []
    assert len(drawn(other.path)["motors/0_outputs"][0]) == rows
    assert_allclose(
        drawn(stalled.path)["motors/0_outputs"][0], 50.0 + DT * np.arange(100, rows), atol=1e-7
    )
    assert "100 rows are not shown here: this view is too slow" in texts(stalled.path)


def test_figures_and_status_show_what_is_known_and_a_model_outlives_the_flight():
    """The texts beside the plots, before the first model and with one."""
    row = ROW._replace(time=60.0)
    status = SessionStatus(no_model_reason=prose("The vehicle is on the ground."))
    first_figures = current_value_texts(status, row, CHANNELS, None)
    assert all("### –" in figure for figure in first_figures[1:6])
    assert first_figures[0].count("The vehicle is on the ground.") == 1
    assert "unknown: motors, vibration, " in first_figures[0]
    assert "No model yet. The vehicle is on the ground." in status_document(
        status, row, CHANNELS, None
    )
    assert "learned up to 5.0 s ago" in status_document(status, row, CHANNELS, 55.0)
    status = SessionStatus(
        wind=WIND,
        learned_rows=4200,
        prediction_band=PredictionBand(0.25, np.radians(2.0)),
        useful_horizon=UsefulHorizon(0.5, 0.41),
    )
    latest_estimate = estimate(60, 60.0)
    timeline_times = "\n".join(
        current_value_texts(status, row._replace(estimate=latest_estimate), CHANNELS, 59.0)
    )
    for words in (
        "42 s learned",
        "± 2.0°\n0.25 s ahead",
        "340 ± 30 °/s²",
        "5.7 ± 0.6 °/s² per µs\nrate damping not identifiable",
        "### 5.0 m/s (4.5 to 5.5) ↖\nfrom SE (127°) ↖",
    ):
        assert words in timeline_times
    assert [fact.code for fact in WIND.facts] == [SessionFact.WIND_SPEED, SessionFact.WIND_FROM]


def test_the_first_figure_has_headline_next_step_and_what_is_bad():
    loss = MotorChange(58.0, 56.0, 2, "motor 2", 0.3, 0.99, loss=(0.2, 0.4))
    status = SessionStatus(is_flying=True, motor_alarms=(loss,), motor_alarms_of_flight=(loss,))
    headline, next_step = headline_and_next_step(status.overall_judgement)
    first_figure, *_ = current_value_texts(status, ROW._replace(time=60.0), CHANNELS, 59.0)
    assert "motor 2 lost 20 to 40 %" in headline.lower() and next_step.startswith("Next: Land now")
    assert first_figure.startswith(f"### {headline}\n**{next_step}**")
    assert "**bad: motors**" in first_figure and "\n\nunknown: vibration, " in first_figure


def test_a_row_that_cannot_be_drawn_and_a_file_that_cannot_be_written_end_nothing(tmp_path):
    """One estimate has no predictions, and one file is in a folder that does not exist."""
    path = tmp_path / "flight.rrd"
    with showing(RecordingFile(tmp_path / "nowhere" / "flight.rrd"), RecordingFile(path)) as view:
        thread = view._threads[1]
        odd = estimate(20, 50.0)._replace(ahead=np.zeros((0, 2)))
        view.put(ROW._replace(estimate=odd))
        until(lambda: thread._events)
        view.put(ROW._replace(time=50.1))
    size = path.stat().st_size
    view.put(ROW)  # A closed view shows nothing more.
    view.close()
    assert path.stat().st_size == size
    (problem,) = view.problems
    assert "nowhere/flight.rrd cannot be written" in problem
    assert texts(path)[0].startswith("not drawn: ") and len(drawn(path)["motors/0_outputs"][0]) >= 1


FULL_DISK = """
import resource, shutil, signal, sys
from contextlib import closing
import mavdem.view.live_view
from test_live_view import CHANNELS, DT, ROW, Held, LiveView, until

sink = Held(sys.argv[1])
sink.period = 0.01
mavdem.view.live_view.CLOSING_SECONDS = mavdem.view.live_view.FLUSH_SECONDS = 0.5
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
with closing(LiveView([sink])) as view:
    view.change(CHANNELS)
    for i in range(500):
        view.put(ROW._replace(time=50.0 + DT * i))
    sink.go.set()
    until(lambda: sink.complete_bytes)
    shutil.copy(sink.path, sys.argv[2])  # as a process that is killed leaves it
    resource.setrlimit(resource.RLIMIT_FSIZE, (sink.path.stat().st_size + 3000,) * 2)
    # What fails while it is flushed is noticed by a later flush, or Rerun no longer answers.
    until(lambda: [view.put(ROW) for _ in range(500)] and view.problems)
"""


@mark.in_full
def test_a_killed_process_or_a_full_disk_leaves_a_file_that_opens(tmp_path):
    path, killed = tmp_path / "flight.rrd", tmp_path / "killed.rrd"
    command = [sys.executable, "-c", FULL_DISK, str(path), str(killed)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run(command, env=environment, check=True, timeout=5 * PATIENCE)
    assert len(drawn(killed)["motors/0_outputs"][0]) == 500
    assert len(drawn(path)["motors/0_outputs"][0])  # The sink opens.


def test_rows_wait_while_they_are_held_and_come_when_it_closes(tmp_path):
    path = tmp_path / "flight.rrd"
    sending = SinkThread(RecordingFile(path), uuid4())
    sending.is_paused = True
    for time in TIME:
        sending.put(CHANNELS, ROW._replace(time=time))
    sending.send_waiting()
    assert "motors/0_outputs" not in drawn(path)
    sending.closing.set()
    sending.send_waiting()
    assert_allclose(drawn(path)["motors/0_outputs"][0], TIME, atol=1e-8)


def test_a_requested_view_is_shown_or_refused(monkeypatch, tmp_path):
    """Options for a file or a viewer give a sink; a wrong address is refused with an example."""
    # With a screen too: a server keeps what the file has.
    for has_screen in (True, False):
        monkeypatch.setattr(
            "mavdem.view.sinks.has_screen", lambda timeline_times=has_screen: timeline_times
        )
        assert [type(sink) for sink in requested_sinks(rrd=tmp_path / "flight.rrd")] == [
            RecordingFile
        ]
    assert requested_sinks() == []
    assert [type(sink) for sink in requested_sinks(connect="rerun+http://127.0.0.1:1/proxy")] == [
        Viewer
    ]
    for url in ("http://127.0.0.1:9876/proxy", "rerun+http://:1/proxy", "rerun://x:99999/proxy"):
        with raises(ValueError, match="looks like rerun\\+http://127.0.0.1:9876/proxy"):
            Viewer(url)


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


def test_a_viewer_that_is_not_there_is_not_connected_to(monkeypatch):
    # Rerun's own client would keep all rows, and wait for ten seconds at the end.
    monkeypatch.setattr(rr.RecordingStream, "connect_grpc", lambda *_: fail("connected"))
    with showing(Viewer(f"rerun+http://127.0.0.1:{free_port()}/proxy")) as view:
        view.put(ROW)
        until(lambda: view.problems)
        assert "there is no viewer at rerun+http" in view.problems[0]


SERVING = """
import sys, time
from mavdem.view.sinks import WebServer
server = WebServer(*map(int, sys.argv[1:]))
print(server.page, flush=True)
time.sleep(3600)
"""


def test_the_server_is_local_reports_to_nobody_and_ends_with_its_starter(
    tmp_path,
):
    """The server of the viewer listens on this computer only, and writes no file for Rerun's analytics."""
    ports = free_port(), free_port()
    unset = ("CI", "XDG_CONFIG_HOME", "XDG_DATA_HOME")
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    environment |= {"HOME": str(tmp_path), "FORCE_RERUN_ANALYTICS": "1"}
    command = [sys.executable, "-c", SERVING, *map(str, ports)]

    def listening():
        processes = psutil.Process(owner.pid).children(recursive=True)
        sockets = [socket for process in processes for socket in process.net_connections("inet")]
        return {tuple(socket.laddr) for socket in sockets if socket.status == psutil.CONN_LISTEN}

    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as owner:
        assert until(lambda: len(listening()) == 2 and listening()) == {
            ("127.0.0.1", port) for port in ports
        }
        page = owner.stdout.readline().strip()
        with showing(Viewer(f"rerun+http://127.0.0.1:{ports[0]}/proxy")) as view:
            view.put(ROW)
            until(lambda: not view._threads[0]._rows)
        assert view.problems == []
        with urllib.request.urlopen(page) as document:
            assert b"rerun" in document.read().lower()
        # The process of the viewer reports nothing to Rerun: what reports begins with a file that says who it is.
        assert not [path for path in tmp_path.rglob("*") if path.is_file()]
        with raises(OSError, match=f"port {ports[0]} of 127.0.0.1 is taken"):
            WebServer(*ports)
        owner.kill()
    until(lambda: all(socket.socket().connect_ex(("127.0.0.1", port)) for port in ports))
