"""Figures of whole flights beside those of before: a sign, a unit or a threshold that changes shows in some of them.

``--write-golden`` writes them, to be compared before they are kept. With ``--in-full`` figures of many more flights are
compared with those that both options together wrote into build/golden, by another version, where there are any.
"""

import re
from collections import defaultdict, deque
from concurrent.futures import Executor, Future
from math import inf, isfinite
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
from command_line import run, strict_json
from golden_figures import compares_in_full, figures, hold
from pyarrow.types import is_duration, is_fixed_size_list, is_floating, is_list
from pytest import mark, param
from recorded_flights import LOGS, shared
from rerun_file import chunks
from standin_logs import InThisProcess

from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.ingest import read_log
from mavdem.ingest.formats import read_stream
from mavdem.live.link import ReceivedPiece

pytestmark = mark.slow

FILES = {".html", ".csv", ".rrd", ".param", ".params", ".toml", ".sdf", ".tlog", ".npz"}
# Not of pictures and colours, nor of the day on which a page was written and of the digest of its log.
STYLE = re.compile(
    r"<style>.*?</style>|<footer>.*?</footer>|<strong>SHA-256 of the log</strong> \w+", re.DOTALL
)
NUMBER = re.compile(r"(?:base64,|#)[\w+/=]*|(-?\d+(?:\.\d+)?(?:e-\d+)?)")
FLIGHTS = {
    # A lost motor of four and of six.
    "real/logs/px4_motor_failure.ulg": ["review"],
    "real/logs/sitl_hexa_plus_motor6_lost.bin": ["review"],
    # What is learned.
    "ardupilot_wind5_steps.tlog": ["review", "tune", "info", "convert"],
    # What is in logs of slow streams and of a short flight.
    "ardupilot_default_rates.tlog": ["info", "review", "> convert"],
    "real/logs/low_flight_climb_channel_zero.tlog": ["info"],
    "logs/pyulog_sample.ulg": ["review"],
}
"""What is run of each log. Of a command after ">" it is what stands on its screen."""
LONG_FLIGHTS = {
    # A crash, and a propeller whose tip is cut.
    "real/logs/crash_motor2_mechanical.bin": ["review", "> review"],
    "real/propeller/hover_good_1.BIN real/propeller/hover_cut25mm_1.BIN": ["track", "diff"],
    # A scenario's flight, which the commands after the first read, live and from its log.
    "ardupilot_steps": ["fly", "wind", "live", "> info --verbose"],
}
"""What only ``--in-full`` runs, and compares with stored figures, too."""
MORE_FLIGHTS = {
    "real/propeller/hover_good_1.BIN real/propeller/hover_cut25mm_1.BIN": [
        "track",
        "diff",
        "> diff",
    ],
    "ardupilot_wind5_steps.tlog": ["review", "tune", "info", "convert", "> info --verbose"],
    "real/logs/gains_named_before_34.BIN": [
        "review",
        "tune",
        "twin",
        "wind",
        "> wind --verbose",
    ],
    "real/logs/yaw_twist_16_percent.BIN": ["review"],
    "real/propeller/hover_cut20mm_1.BIN": ["review"],
    "real/logs/ardupilot_range_1075_1920_slow.tlog": ["review"],
    "real/logs/crash_motor4_at_its_limit.BIN": ["review"],
    "real/logs/crash_errors_without_time.BIN": ["review"],
    "real/logs/ardupilot_motor2_at_its_limit.BIN": ["review"],
    "sitl_raw/ap_sid.BIN.xz": ["review", "tune"],
    "sitl_raw/ap_raw_on.BIN.xz": ["info"],
    "real/logs/ardupilot33_rate_in_centidegrees.bin": ["info"],
    "real/logs/ardupilot34dev_rate_in_centidegrees.BIN": ["info"],
    "real/logs/ardupilot_gimbal_on_channels_5_and_6.BIN": ["info"],
    "real/logs/ardupilot_late_landed_state.tlog": ["info"],
    "real/logs/ardupilot_motor3_at_its_limit.BIN": ["info"],
    "real/logs/armed_on_the_ground.BIN": ["info"],
    "real/logs/no_fault_while_yawing.BIN": ["info"],
    "real/logs/px4_crash_hovers_at_12_percent.ulg": ["info"],
    "real/logs/px4_default_rates_gps_interference.ulg": ["info", "wind"],
    "real/logs/px4_default_rates_learnable.ulg": ["review", "tune", "> tune --verbose"],
    "real/logs/px4_outputs_change_noutputs_0_and_4.ulg": ["info"],
    "real/logs/px4_pwm_1200_1950.ulg": ["info"],
    "real/logs/px4_two_armed_times.ulg": ["info"],
    "real/propeller/straight_cut25mm_1.BIN": ["info", "wind"],
    "logs/dronekit_flight.tlog": ["review"],
    "logs/wlichon_baseline.BIN": ["review"],
    "sitl_events/ap_motor.tlog": ["info"],
    "sitl_px4/px4_two_vehicles_gcslink.tlog": ["info"],
    "sitl_events/ap_quiet10.BIN": ["info"],
    "sitl_events/px4_windjump.ulg.xz": ["info", "wind", "> wind --verbose"],
    "sitl_loops/ap_t_half_f1_with_params.tlog.xz": ["info", "tune"],
    "sitl_loops/px4_pxlow2.tlog.xz": ["info", "tune"],
    "wind_turns": ["fly", "wind", "> wind --verbose"],
    "iris_gusts": ["fly", "learn"],
}
"""Flights, and commands of a flight, whose figures are compared with those in build/golden: they take minutes."""
SCENARIOS = {"calm": 16, "crazyflie_gusts": 16, "lossy_link": 16, "paper_5": 16}
"""For how long each scenario is flown, s."""
FURTHER_SCENARIOS = {"crazyflie_gusts", "paper_5"}
"""Scenarios that only ``--in-full`` flies."""
MORE_SCENARIOS = {
    "calm": 20,
    "crazyflie_gusts": 20,
    "lossy_link": 25,
    "paper_5": 20,
    "ardupilot_faults": 30,
    "default_rates": 30,
    "hover_blower": 20,
    "iris_chipped_propeller": 64,
    "iris_doublets": 25,
    "iris_dryden": 25,
    "iris_identification_wind": 25,
    "iris_multisine": 20,
    "iris_shifted_load": 64,
    "iris_sticks": 25,
    "iris_von_karman": 25,
    "iris_weak_motor": 64,
    "oscillating_frame": 25,
    "oscillating_gains": 25,
    "system_4": 20,
    "wind_hover": 40,
    "wind_jump": 65,
    "wind_legs": 95,
    "wind_turning": 60,
}
"""Scenarios whose figures are compared with those in build/golden, and for how long each is flown, s."""
FLOWN = "flown.tlog"
FLIGHT_SECONDS, FULL_FLIGHT_SECONDS = 46, 60
"""For how long is flown what other commands then read, s, and for build/golden; a wind needs 30 s of hover."""
LIVE_SECONDS = 22
"""For how long a session listens to that flight, s, unless for build/golden: a first model comes after about 12 s."""
TICK = 0.06  # Seconds from one look at the link to the next.
OPTIONS = {
    "review": ["--out", "out", "--rrd"],
    "track": ["--out", "fleet", "--jobs", "1"],
    "diff": ["--out", "diff"],
    "tune": ["--axis", "all", "--out", "tuned"],
    "convert": ["flight.csv"],
    "fly": ["--out", FLOWN, "--rrd", "flown.rrd"],
    "live": ["--request-rate", "100", "--rrd", "live.rrd", "--record", "live.mcap"],
    "learn": ["--truth", "flown.truth.npz", "--out", "learnt", "--rrd"],
    "twin": [f"--out=twin.{ending}" for ending in ("toml", "json", "params", "sdf")],
}


def lines(screen):
    """The numbers of each line, by its words."""
    values_by_name = defaultdict(list)
    for line in screen.splitlines():
        if "took" not in line:
            words = " ".join(NUMBER.sub("#", line).split())
            values_by_name[words] += map(float, filter(None, NUMBER.findall(line)))
    return {words: numbers or ["said"] for words, numbers in values_by_name.items()}


def written(path):
    """Returns all numbers of a file by their place. For a page that is the section, for a recording the entity."""
    values_by_name = defaultdict(list)
    if path.suffix == ".rrd":
        seconds = defaultdict(float)
        for name, _, batch in chunks(path, static=True):
            for column, values in zip(batch.schema.names, batch.columns, strict=True):
                while is_list(values.type) or is_fixed_size_list(values.type):
                    values = values.flatten()
                if is_duration(values.type) and "Scalars:scalars" in batch.schema.names:
                    seconds[f"{name} {column}"] += sum(values.cast("int64").to_pylist()) / 1e9
                if is_floating(values.type) and "SeriesLines" not in column:
                    values_by_name[f"{name} {column}"] += filter(isfinite, values.to_pylist())
        values_by_name |= {
            # Which of equal samples a plot keeps depends on the rounding of the processor.
            f"{column} in all": [total]
            for column, total in seconds.items()
        }
    elif path.suffix in (".npz", ".tlog"):
        is_truth = path.suffix == ".npz"
        tables = {"truth": np.load(path)} if is_truth else read_log(path).vehicles[0].messages
        for name, columns in tables.items():
            for column, values in columns.items():
                if values.dtype.kind in ("f" if is_truth else "iuf"):
                    values_by_name[f"{name} {column}"] += (
                        values[np.isfinite(values)].ravel().tolist()
                    )
    else:
        # How a page looks, and from what it was made, are no figures.
        page = STYLE.sub("", path.read_text()).replace("−", "-")
        for number, part in enumerate(page.split("<section")):
            values_by_name[f"{path.name} {number}"] += map(
                float, filter(None, NUMBER.findall(part))
            )
    return values_by_name


class RecordedLink:
    """What a log has received, on the clock of its stamps, however busy the machine is."""

    now = 0.0
    longest = inf  # Seconds after which nothing more is received.
    awaits_greeting = False
    dropped_datagrams = 0
    close = send = Mock()
    drain_events = receive_rest = list

    def __init__(self, name):
        self.name = name
        frames = list(read_stream(Path(name)).stamped_frames())
        RecordedLink.now = frames[0][0] / 1e6
        end = RecordedLink.now + self.longest
        self.frames = deque((stamp, frame) for stamp, frame in frames if stamp / 1e6 < end)

    def receive(self, timeout):
        RecordedLink.now += TICK
        came = []
        while self.frames and self.frames[0][0] / 1e6 <= self.now:
            stamp, frame = self.frames.popleft()
            came.append(ReceivedPiece(stamp / 1e6, frame))
        return came


class AtOnce(Executor):
    """Does each job when it is given, whatever the priority of the process would be."""

    def __init__(self, niceness=0):
        pass

    def submit(self, job, *arguments, **options):
        done = Future()
        done.set_result(job(*arguments, **options))
        return done


def replay(session, *_):
    """Runs the session until all of the log has been received."""
    while session.link.frames:
        session.step()


def by_the_log(monkeypatch, seconds):
    """Lets ``mavdem live`` replay these first seconds of a log."""
    monkeypatch.setattr(RecordedLink, "longest", seconds)
    clock = SimpleNamespace(monotonic=lambda: RecordedLink.now, time=lambda: RecordedLink.now)
    monkeypatch.setattr("mavdem.live.clock.time", clock)
    monkeypatch.setattr("mavdem.cli.live.Link", RecordedLink)
    monkeypatch.setattr("mavdem.cli.live.LearningProcess", AtOnce)
    monkeypatch.setattr("mavdem.cli.live.run_session", replay)
    # All is drawn when it ends, however long that takes.
    for name in (
        "sinks.RecordingFile.period",
        "live_view.CLOSING_SECONDS",
        "live_view.FLUSH_SECONDS",
    ):
        monkeypatch.setattr(f"mavdem.view.{name}", 600.0)


def pytest_generate_tests(metafunc):
    """The flights of the tests: few, with ``--in-full`` the long ones, and for build/golden all."""
    in_full = compares_in_full(metafunc.config)
    if "log" in metafunc.fixturenames:
        flights = FLIGHTS | LONG_FLIGHTS | (MORE_FLIGHTS if in_full else {})
        cases = [
            param(log, commands, marks=mark.in_full if log in LONG_FLIGHTS else ())
            for log, commands in flights.items()
        ]
        metafunc.parametrize("log, commands", cases, ids=flights)
    if "scenario" in metafunc.fixturenames:
        scenarios = SCENARIOS | (MORE_SCENARIOS if in_full else {})
        cases = [
            param(name, seconds, marks=mark.in_full if name in FURTHER_SCENARIOS else ())
            for name, seconds in scenarios.items()
        ]
        metafunc.parametrize("scenario, seconds", cases, ids=scenarios)


@mark.usefixtures("logs_read_once")
def test_the_figures_of_a_flight_are_those_of_before(
    log, commands, here, monkeypatch, capsys, request
):
    """Runs commands on a log, and compares all numbers that they print or write with stored ones."""
    sample = LOGS / log  # The repository may have the log.
    flights = [log]
    if sample.is_file():
        Path(log).symlink_to(sample)  # A command in a next step contains this name.
    elif sample.suffix:
        flights = [shared(name) for name in log.split()]
    in_full = compares_in_full(request.config)
    if "live" in commands:
        by_the_log(monkeypatch, inf if in_full else LIVE_SECONDS)
    # Another process would take a second to import what reads logs, and keep nothing for the next command.
    monkeypatch.setattr("mavdem.cli.track.WorkerPool", lambda *_: InThisProcess(rows_of_log))
    # A line that wraps would have other words where a figure has a digit more.
    monkeypatch.setattr("mavdem.cli.streams.MAX_COLUMNS", 10_000)
    seconds = FULL_FLIGHT_SECONDS if in_full else FLIGHT_SECONDS
    options = OPTIONS | {"fly": [*OPTIONS["fly"], "--duration", seconds]}
    values_by_name = {}
    for line in commands:
        command, *output_arguments = line.removeprefix("> ").split()
        output_options = output_arguments if line.startswith("> ") else ["--json"]
        values_by_name[f"{line} exits"] = [
            run(command, *flights, *options.get(command, ()), *output_options)
        ]
        flights = {"fly": [FLOWN], "live": ["live.mcap"]}.get(command, flights)
        printed = capsys.readouterr().out
        if output_options == ["--json"]:
            document = strict_json(printed)
            values_by_name |= {command + key: values for key, values in figures(document).items()}
        else:
            values_by_name |= {
                f"{command} shows {words}": numbers for words, numbers in lines(printed).items()
            }
    for file in here.rglob("*.*"):
        if file.suffix in FILES and not file.is_symlink() or file.name == "twin.json":
            values_by_name |= written(file)
    hold(Path(log).stem, values_by_name, request)


def test_a_scenario_is_flown_as_before(scenario, seconds, here, capsys, request):
    assert run("fly", scenario, "--duration", seconds, "--out", FLOWN, "--json") == 0
    values_by_name = figures(strict_json(capsys.readouterr().out))
    for file in here.iterdir():
        values_by_name |= written(file)
    hold(scenario, values_by_name, request)


def test_what_a_scenario_leaves_out_is_as_before(capsys, request):
    assert run("fly", "calm", "--describe") == 0
    hold("described", lines(capsys.readouterr().out), request)
