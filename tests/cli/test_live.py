"""``mavdem live``: what it refuses, what it keeps, and that it ends as it should, beside a simulated vehicle."""

import os
import re
import signal
import socket
from concurrent.futures import wait
from contextlib import closing
from math import inf
from types import SimpleNamespace
from unittest.mock import Mock

from command_line import free_port, refused, run, strict_json
from live_faults import Wire
from patience import PATIENCE
from pytest import approx, mark, raises
from rerun_file import drawn
from take_over import record_take_over, systems_in

import mavdem
from mavdem.cli import live
from mavdem.cli.commands import main
from mavdem.dem.learning import MIN_SAMPLES
from mavdem.dem.parallel import LearningProcess
from mavdem.fleet.priors import EarlierDrag
from mavdem.ingest import read_log
from mavdem.live.session import LiveSession
from mavdem.live.vehicle_state import VehicleState
from mavdem.processes import TERMINATION_SIGNALS
from mavdem.wind_velocity.vehicle_drag import Drag
from sitl_scenarios.files import load
from sitl_scenarios.mavlink.live import Ground, fly_live
from sitl_scenarios.simulation import Simulation


@mark.slow
@mark.parametrize(
    "line, said",
    {
        "nonsense:1:2:3": "is not a link",
        "udpin:127.0.0.1:0 --prior /dev/zero": "is no learned model",
        "udpin:127.0.0.1:0 --record x.bin": "--record",
        "udpin:127.0.0.1:0 --rrd x.tlog": "--rrd",
        "udpin:127.0.0.1:0 --rrd none/x.rrd": "there is no folder none",
        "udpin:127.0.0.1:0 --model x.txt": "--model",
        "udpin:127.0.0.1:0 --connect nowhere": "--connect",
        "udpin:127.0.0.1:0 --request-rate nan": "--request-rate",
        "udpin:127.0.0.1:0 --token 0123456789abcdef": "those of --serve",
        "udpin:127.0.0.1:0 --serve --host 0.0.0.0": "could watch the flight",
        f"udpin:127.0.0.1:0 --serve --token {16 * 'x'} --host {300 * 'x'}": "another --host",
        "udpout:127.0.0.1:14550": "nothing is sent without --request-rate",
    }.items(),
)
def test_what_cannot_be_is_refused_in_a_sentence(line, said, capsys, here):
    """A wrong address or option ends the command with exit code 2, and writes no file."""
    assert said in refused(capsys, 2, "live", *line.split())
    assert list(here.iterdir()) == []


def test_a_terminal_has_a_status_before_libraries_are_loaded(monkeypatch):
    calls = Mock()
    monkeypatch.setattr(live, "STDERR", Mock(is_terminal=True))
    monkeypatch.setattr(live, "run_session", calls.run_session)
    live._run_and_show_status(Mock(), calls.lines, Mock(), None, plain=False)
    names = [name for name, _, _ in calls.mock_calls]
    assert names == [
        "lines.start_in_place",
        "lines.show",
        "run_session",
        "lines.stop_in_place",
    ]


@mark.slow
def test_a_model_that_cannot_be_written_costs_nothing_else(tmp_path, capsys, monkeypatch):
    """The folder of the model is deleted during the session, and learning takes a minute at its end."""
    folder = tmp_path / "gone"
    folder.mkdir()

    def fly(session, *_):
        folder.rmdir()
        # What takes its time at the end is no silence of the link's.
        session.flight.learning.learner = Mock(
            no_model_reason=None, **{"learn_now.side_effect": lambda _: late(session)}
        )

    def late(session):
        session._silence_monitor.message_time -= 60
        return Mock(**{"to_json.return_value": "{}"})

    monkeypatch.setattr("mavdem.cli.live.run_session", fly)
    monkeypatch.setattr("mavdem.cli.live.live_page", lambda *_, **__: "")
    monkeypatch.setattr("mavdem.cli.live.LiveSession.judge_final_model", lambda *_: None)
    assert (
        run("live", f"udpin:127.0.0.1:{free_port()}", "--model", folder / "m.json", "--json") == 2
    )
    captured = capsys.readouterr()
    document = strict_json(captured.out)
    assert document["model"] is None and document["obstacle"].startswith("No vehicle yet")
    assert (
        "The model is lost" in captured.err
        and "The page is lost" in captured.err
        and document["html"] is None
    )
    assert "there is no folder" in captured.err


@mark.slow
def test_the_vehicle_that_sends_after_the_followed_one_has_files_of_its_own(
    here, capsys, monkeypatch
):
    """Vehicle 1 is silent and vehicle 2 sends.

    The second session has files of its own, whose number is free for all of them.
    """
    sessions = []

    def fly(session, is_end_requested, *_):
        sessions.append(session)
        if len(sessions) == 1:
            record_take_over(session)
        assert is_end_requested() == (len(sessions) == 1)

    monkeypatch.setattr("mavdem.cli.live.run_session", fly)
    # A file that is not named, but written beside the recording.
    (here / "f-2.model.json").touch()
    words = f"udpin:127.0.0.1:{free_port()} --record f.tlog --html f.html --json"
    assert run("live", *words.split()) == 1
    _, second = sessions
    assert second.stream.status().no_model_reason.subject == "2:1"
    names = {path.name for path in here.iterdir()}
    assert {"f.tlog", "f.html", "f-3.tlog", "f-3.html"} <= names and "f-2.tlog" not in names
    # The session of 2:1 ends before it has analysed anything, and its recording has the frames all the same.
    assert systems_in(here / "f.tlog") == [1] and systems_in(here / "f-3.tlog") == [2]
    document = strict_json(capsys.readouterr().out)
    (earlier,) = document["earlier"]
    assert earlier["html"] == "f.html" and "earlier" not in earlier
    assert earlier["record"]["frames"] == document["record"]["frames"] > 0
    assert document["record"]["file"] == "f-3.tlog"


@mark.slow
@mark.parametrize("end", ["signal", "late signal", "duration", "folder"])
def test_what_was_recorded_of_a_vehicle_that_is_not_followed_any_more_stays_where_it_is(
    here, monkeypatch, end
):
    """The user ends the command in a take-over, its duration is over, or no further file can be created."""
    folder = here / "flights"
    folder.mkdir()

    def fly(session, *_):
        record_take_over(session)
        if end == "signal":
            signal.raise_signal(signal.SIGINT)

    def page(*_, **__):
        if end == "late signal":
            signal.raise_signal(signal.SIGINT)
        elif end == "duration":
            monkeypatch.setattr("mavdem.cli.live.monotonic", lambda: inf)
        elif end == "folder":
            folder.rename(here / "renamed")
        return ""

    monkeypatch.setattr("mavdem.cli.live.run_session", fly)
    monkeypatch.setattr("mavdem.cli.live.live_page", page)
    handlers = {number: signal.getsignal(number) for number in TERMINATION_SIGNALS}
    words = f"udpin:127.0.0.1:{free_port()} --record flights/f.tlog --duration 1000"
    try:
        assert run("live", *words.split()) == (2 if end == "folder" else 1)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    (recording,) = here.glob("*/*.tlog")
    assert sorted(systems_in(recording)) == [1, 2]


@mark.slow
def test_without_a_vehicle_it_ends_with_nothing_kept(here, capsys, monkeypatch):
    """Only bytes that are no MAVLink arrive."""
    port = free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.0.1", 0))

        def listen_to_stranger(*arguments):
            stranger.sendto(b"\xfd" + bytes(200), ("127.0.0.1", port))
            return listen(*arguments)

        listen = live.run_session
        monkeypatch.setattr(live, "run_session", listen_to_stranger)
        words = f"live udpin:127.0.0.1:{port} --rrd f.rrd --record f.tlog --duration 0.3 --json"
        assert main(words.split()) == 1
        stranger.settimeout(0.1)
        with raises(TimeoutError):
            stranger.recv(100)  # Not one byte is sent.
    captured = capsys.readouterr()
    document = strict_json(captured.out)
    assert "No vehicle" in captured.err
    assert document["vehicle"] is document["model"] is document["rrd"] is document["record"] is None
    # A recording without a message is no log to judge.
    assert "f.tlog was not written" in captured.err and not (here / "f.tlog").exists()
    assert document["samples"] == {"learnt": 0, "shown": 0}


@mark.slow
@mark.usefixtures("coarse_physics")
def test_a_simulated_vehicle_is_learnt_from_and_everything_is_kept(here, capsys, monkeypatch):
    """Over a real link, but on the clock of the flight: however busy the machine is.

    The first model is learned in a process of its own, which a busy machine may run only when the flight is over: the
    flight's clock waits for it.
    """
    port = free_port()
    now = [100.0]
    clock = SimpleNamespace(monotonic=lambda: now[0], time=lambda: 1.7e9 + now[0])
    run_on = live.run_session
    final_model = LiveSession.final_model
    submit = LearningProcess.submit
    flown = []
    learned_in_process = []

    def submitted(process, *task):
        learned_in_process.append(submit(process, *task))
        return learned_in_process[-1]

    class Air(Ground):
        """Has the session take what was sent before the vehicle hears what it was answered."""

        def __init__(self, session, show):
            super().__init__("127.0.0.1", port)
            self.session, self.show, self.began = session, show, now[0]
            self.shown = now[0]

        def received(self, until):
            now[0] = self.began + (until - self.began) * Wire.speed
            self.session.step(0.0)
            wait(learned_in_process[:1], PATIENCE)
            # A look at each step would take longer than the steps.
            if now[0] - self.shown >= 0.5:
                self.shown = now[0]
                self.show(self.session)
            yield from super().received(0.0)

    def fly(session, asked, *given):
        hear = session.link.receive
        monkeypatch.setattr("sitl_scenarios.mavlink.live.monotonic", clock.monotonic)
        session.link.receive = lambda timeout: now.__setitem__(0, now[0] + timeout) or hear(0.0)
        scenario = load("ardupilot_steps")
        slower = scenario.vehicle.model_copy(update={"parameters": {"SCHED_LOOP_RATE": 100.0}})
        changes = {"duration": 18.0, "height": 5.0, "vehicle": slower}
        scenario = scenario.model_copy(update=changes)
        with closing(Air(session, given[-1])) as air:
            watch = Mock()
            flown.append(fly_live(scenario, Simulation(scenario), air, Wire.speed, watch))
        signal.raise_signal(signal.SIGINT)
        run_on(session, asked, *given)

    def interrupted(session):
        for number in (signal.SIGINT, signal.SIGHUP):  # Signals change nothing, whenever they come.
            os.kill(os.getpid(), number)
        return final_model(session)

    for name, value in {
        "mavdem.cli.live.run_session": fly,
        "mavdem.dem.parallel.LearningProcess.submit": submitted,
        "mavdem.cli.live.LiveSession.final_model": interrupted,
        "mavdem.live.learning.FIT_SECONDS": PATIENCE,
        "mavdem.live.link.SO_TIMESTAMPNS": 0,  # Pieces arrive when they are read.
        "mavdem.live.link.time": clock,
        "mavdem.live.clock.time": clock,
        # The flight is simulated faster than it is flown, and what is watched changes as fast.
        "mavdem.cli.live_status.SETTLING_SECONDS": 0.0,
    }.items():
        monkeypatch.setattr(name, value)
    words = f"udpin:127.0.0.1:{port} --rrd f.rrd --record f.tlog --request-rate 10 --preset paper --order 4 --json"
    ending = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    handlers = {number: signal.getsignal(number) for number in ending}
    try:
        assert run("live", *words.split()) == 0
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    printed = capsys.readouterr()
    captured = printed.err
    assert "First model of roll" in captured and "should not have happened" not in captured
    # The states of the learning are in the status, and have no lines of their own.
    assert "The model is being learned. Fly on" not in captured
    assert re.search(r"in flight 0:\d\d, .*; learning", captured)
    assert re.search(r"Watched: .*\boscillation\b.*\(since \d+ s\)", captured)
    document = strict_json(printed.out)
    assert (
        document["vehicle"] == "1:1"
        and document["samples"]["learnt"] > 500
        and document["lost"] == 0
    )
    assert document["record"]["frames"] > 1000 and flown[0].commands >= 4
    assert document["rates"]["ATTITUDE"] == approx(100, rel=0.1), (
        "what comes faster already is not lowered"
    )
    learned = mavdem.Learned.from_json((here / document["model"]).read_text())
    assert (learned.settings.prior, learned.settings.order) == ("uniform", 4)
    assert len(learned.model.B.T) == 4 and len(learned.record) >= 2 * MIN_SAMPLES
    assert {*drawn(here / "f.rrd")} >= {"motors/0_outputs", "axes/pitch/1_measured"}
    assert read_log(here / "f.tlog").vehicles[0].messages["ATTITUDE"]["time"].size > 300


def test_a_prior_of_another_autopilot_or_frame_is_refused():
    """A name decides nothing: it depends on which parameters have come."""
    session = Mock()
    prior_drag = EarlierDrag(Drag.from_parameters(), "board 5", "PX4", "QUADROTOR")
    for autopilot, frame in (("PX4", "QUADROTOR"), ("", ""), ("PX4", "GENERIC")):
        state = VehicleState(autopilot=autopilot, frame=frame, name_in_logs="board 6")
        live._refuse_prior_of_another_vehicle(session, prior_drag, state)
    assert not session.refuse_prior.called
    state = VehicleState(autopilot="ARDUPILOTMEGA", frame="HEXAROTOR")
    live._refuse_prior_of_another_vehicle(session, prior_drag, state)
    (reason,) = session.refuse_prior.call_args.args
    assert "another vehicle (PX4 quadrotor) than this one (ArduPilot hexarotor)" in str(reason)
