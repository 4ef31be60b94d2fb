"""``mavdem live``: what it refuses, what it keeps, and that it ends as it should, beside a simulated vehicle."""

import contextlib
import json
import re
import signal
import socket
import subprocess
import time
from unittest.mock import Mock

import psutil
from command_line import MAVDEM, PATIENCE, free_port, refused, run
from pytest import approx, fixture, mark, raises
from rerun.chunk import RrdReader

import mavdem
from mavdem.cli import live
from mavdem.cli.commands import main
from mavdem.dem.learning import FEWEST_SAMPLES
from mavdem.ingest import read_log

PATIENTLY = (
    f"import mavdem.view.live_view; mavdem.view.live_view.CLOSING_SECONDS = {PATIENCE}; "
    "import mavdem.cli.live; mavdem.cli.live.STATUS_SECONDS = 0.2; "
    f"mavdem.cli.live.ENDING_SECONDS = {PATIENCE}; "
)


@fixture(autouse=True)
def ended():
    """Ends what a failed test has left running."""
    yield
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):
            if "mavdem.__main__" in " ".join(process.cmdline()):
                process.kill()


@mark.parametrize(
    "words, said",
    [
        (["nonsense:1:2:3"], "is not a link"),
        (["udpin:127.0.0.1:0", "--prior", "/dev/zero"], "is no learned model"),
        (["udpin:127.0.0.1:0", "--record", "x.bin"], "--record"),
        (["udpin:127.0.0.1:0", "--rrd", "x.tlog"], "--rrd"),
        (["udpin:127.0.0.1:0", "--rrd", "none/x.rrd"], "there is no folder none"),
        (["udpin:127.0.0.1:0", "--model", "x.txt"], "--model"),
        (["udpin:127.0.0.1:0", "--connect", "nowhere"], "--connect"),
        (["udpin:127.0.0.1:0", "--request-rate", "nan"], "--request-rate"),
        (["udpout:127.0.0.1:14550"], "nothing is sent without --request-rate"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(words, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert said in refused(capsys, 2, "live", *words)
    assert list(tmp_path.iterdir()) == []


def test_a_view_that_is_served_already_is_said_in_a_sentence(capsys):
    with socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with contextlib.suppress(OSError):  # whoever has it will do
            other.bind(("127.0.0.1", 9876))
            other.listen()
        said = refused(capsys, 2, "live", f"udpin:127.0.0.1:{free_port()}", "--serve")
    assert "port 9876 of 127.0.0.1 is taken" in said and said.endswith("view.\n")


@mark.slow
def test_a_model_that_cannot_be_written_costs_nothing_else(tmp_path, capsys, monkeypatch):
    folder = tmp_path / "gone"
    folder.mkdir()

    def fly(session, *_):
        folder.rmdir()
        # What takes its time at the end is no silence of the link's.
        session.learner = Mock(obstacle=None, **{"learn_now.side_effect": lambda _: late(session)})

    def late(session):
        session._heard -= 60
        return Mock(**{"to_json.return_value": "{}"})

    monkeypatch.setattr("mavdem.cli.live.run", fly)
    monkeypatch.setattr("mavdem.cli.live.live_page", lambda *_: "")
    monkeypatch.setattr("mavdem.cli.live.LiveSession.judge", lambda *_: None)
    assert (
        run("live", f"udpin:127.0.0.1:{free_port()}", "--model", folder / "m.json", "--json") == 2
    )
    said = capsys.readouterr()
    told = json.loads(said.out)
    assert told["model"] is None and told["obstacle"] == "No vehicle found yet."
    assert (
        "The model is lost" in said.err and "The page is lost" in said.err and told["html"] is None
    )
    assert "there is no folder" in said.err


@mark.slow
def test_without_a_vehicle_it_ends_with_nothing_kept(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    port = free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.0.1", 0))

        def listen_to_stranger(*arguments):
            stranger.sendto(b"\xfd" + bytes(200), ("127.0.0.1", port))
            return listen(*arguments)

        listen = live.run
        monkeypatch.setattr(live, "run", listen_to_stranger)
        words = f"live udpin:127.0.0.1:{port} --rrd f.rrd --record f.tlog --duration 0.3 --json"
        assert main(words.split()) == 1
        stranger.settimeout(0.1)
        with raises(TimeoutError):
            stranger.recv(100)  # not one byte is sent
    said = capsys.readouterr()
    told = json.loads(said.out)
    assert (
        "No vehicle" in said.err
        and told["vehicle"] is None
        and told["model"] is None
        and told["rrd"] is None
    )
    assert (
        told["samples"] == {"learnt": 0, "shown": 0} and told["headline"] == "No vehicle found yet."
    )


@mark.slow
def test_a_simulated_vehicle_is_learnt_from_and_everything_is_kept(tmp_path):
    port = free_port()
    error = tmp_path / "error"
    words = f"live udpin:127.0.0.1:{port} --rrd f.rrd --record f.tlog --request-rate 10 --preset paper --order 4 --json"
    command = [*MAVDEM[:2], PATIENTLY + MAVDEM[2], *words.split()]
    live = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=error.open("w"), text=True
    )
    fly = f"fly ardupilot_steps --udp 127.0.0.1:{port} --speed 3 --duration 900 --json".split()
    flying = subprocess.Popen(
        [*MAVDEM, *fly], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )

    def wait_for(happens):
        """As long as the flight takes, on a busy machine too."""
        while not happens(said := error.read_text()):
            assert live.poll() is None and flying.poll() is None, said
            time.sleep(0.05)

    wait_for(re.compile(r"learning; [\d,]{5,} samples").search)
    begun = error.read_text()
    assert re.search(r"Watched: .*\boscillation\b.*\(since \d+ s\)", begun)
    assert "The model is being learned" in begun
    live.send_signal(signal.SIGINT)
    wait_for(lambda said: "Ending takes some seconds" in said)
    for number in (signal.SIGINT, signal.SIGHUP):  # which change nothing, whenever they come
        live.send_signal(number)
    told = json.loads(live.communicate()[0])
    flying.send_signal(signal.SIGINT)
    flown = json.loads(flying.communicate()[0])
    said = error.read_text()
    assert (
        live.returncode == 0 and "Traceback" not in said and "should not have happened" not in said
    ), said
    assert told["vehicle"] == "1:1" and told["samples"]["learnt"] > 200 and told["lost"] == 0
    assert told["record"]["frames"] > 1000 and flown["commands"] >= 4
    assert told["rates"]["ATTITUDE"] == approx(100, rel=0.1), (
        "what comes faster already is not lowered"
    )
    learned = mavdem.Learned.from_json((tmp_path / told["model"]).read_text())
    assert (learned.settings.prior, learned.settings.order) == ("uniform", 4)
    # The newest model, or the first where a busy machine has not finished that.
    assert len(learned.model.B.T) == 4 and len(learned.record) >= 2 * FEWEST_SAMPLES
    entities = {str(chunk.entity_path) for chunk in RrdReader(tmp_path / "f.rrd").stream()}
    assert {"/motors", "/axes/pitch/1_measured", "/surprise/samples"} <= entities
    assert read_log(tmp_path / "f.tlog").vehicles[0].messages["ATTITUDE"]["time"].size > 300
