"""Extras: what is missing is named with the command that installs it, and everything else works."""

import json
import os
import re
import socket
import subprocess
import sys
import tomllib
from contextlib import closing
from pathlib import Path
from unittest.mock import Mock

from command_line import free_port
from pytest import mark, raises
from recorded_flights import short_flight

from mavdem.cli import live_dashboard
from mavdem.cli.commands import main
from mavdem.cli.live_dashboard import Dashboard, PageAddress
from mavdem.cli.open import load
from mavdem.errors import Unreadable
from mavdem.extras import EXTRAS, MissingExtra, PackageFact, require_extra
from mavdem.facts import Fact
from mavdem.live.session_status import SessionStatus
from mavdem.log_formats import FORMAT_SIGNATURES, Format

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LOG = ROOT / "logs" / "ardupilot_wind5_steps.tlog"
QUICK = ["--preset", "paper", "--train", "200", "--test", "20"]
INSTALL = "pip install 'mavdem[view]'."


def test_every_extra_of_the_package_is_named_and_all_has_them_all():
    everything, *_ = PROJECT["project"]["optional-dependencies"]["all"]
    assert PROJECT["project"]["optional-dependencies"].keys() == {"all", *EXTRAS}
    assert set(re.findall(r"\w+", everything)) == {"mavdem", *EXTRAS}


@mark.parametrize("extra", EXTRAS)
def test_an_extra_has_the_modules_of_the_extras_that_it_contains(extra):
    requirements = " ".join(PROJECT["project"]["optional-dependencies"][extra])
    for other in re.findall(r"mavdem\[(\w+)\]", requirements):
        assert {*EXTRAS[other]} < {*EXTRAS[extra]}


@mark.slow
def test_every_file_that_is_no_python_is_installed():
    for package, patterns in PROJECT["tool"]["setuptools"]["package-data"].items():
        there = {
            path
            for path in (ROOT / package).rglob("*")
            if path.is_file() and path.suffix != ".py" and "__pycache__" not in path.parts
        }
        assert there == {path for pattern in patterns for path in (ROOT / package).glob(pattern)}


@mark.slow
@mark.parametrize(
    "words",
    [
        ("fly", "hover_blower", "--rrd", "flight.rrd"),
        ("learn", "flight.tlog", "--rrd"),
        ("live", "udpin:127.0.0.1:0", "--connect", "rerun+http://127.0.0.1:9876/proxy"),
        ("open", str(LOG)),
    ],
)
def test_without_rerun_a_dashboard_that_is_asked_for_is_refused(words, here, monkeypatch, capsys):
    """The package rerun is not installed: commands that need it say how to install it."""
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(list(words)) == 2
    out, error_output = capsys.readouterr()
    assert (
        not out
        and error_output.count("\n") == 1
        and error_output.endswith(f" needs rerun: {INSTALL}\n")
    )
    assert list(here.iterdir()) == []
    assert (
        load([str(LOG)]) == 2
        and capsys.readouterr().err == f"The dashboard needs rerun: {INSTALL}\n"
    )
    # One that nobody asked for is left out.
    dashboard = Dashboard("udpin:127.0.0.1:0", "roll", None, address=None, connect=None)
    assert dashboard.advice == ""
    assert dashboard.open(None) is None and dashboard.view is None
    dashboard.close()


def without_modules(monkeypatch, *names):
    """Makes modules look as if they were not installed."""
    monkeypatch.setattr("mavdem.extras.find_spec", lambda name: None if name in names else name)


@mark.slow
def test_without_rerun_browsers_get_the_page_of_a_live_session_alone(monkeypatch):
    without_modules(monkeypatch, "rerun")
    monkeypatch.setattr(live_dashboard, "PAGE_PORT", free_port())
    dashboard = Dashboard("udpin:127.0.0.1:0", "roll", None, address=PageAddress(), connect=None)
    with closing(dashboard):
        address = f"http://127.0.0.1:{live_dashboard.PAGE_PORT}"
        assert dashboard.advice.startswith(f"Open {address} in a browser of this machine.")
        assert dashboard.advice.endswith(INSTALL) and dashboard.view is None


@mark.slow
def test_a_live_page_that_cannot_be_rendered_does_not_end_the_session(monkeypatch, capsys):
    without_modules(monkeypatch, "rerun")
    monkeypatch.setattr(live_dashboard, "PAGE_PORT", free_port())
    dashboard = Dashboard("udpin:127.0.0.1:0", "roll", None, address=PageAddress(), connect=None)
    with closing(dashboard):
        for _ in range(2):
            # A session without a history has no page.
            dashboard.report(Mock(history=None), SessionStatus())
    assert capsys.readouterr().err.count("The display failed") == 1


def test_without_the_server_browsers_get_the_page_of_rerun_alone(monkeypatch):
    without_modules(monkeypatch, "starlette")
    page = "http://127.0.0.1:9090?url=flight"
    viewer = Mock(page=page, period=1.0, is_retried=True)
    viewer.name = "viewer"
    monkeypatch.setattr("mavdem.view.WebServer", Mock(return_value=viewer))
    dashboard = Dashboard("udpin:127.0.0.1:0", "roll", None, address=PageAddress(), connect=None)
    with closing(dashboard):
        assert page in dashboard.advice and "requests fonts" in dashboard.advice
        assert dashboard.advice.endswith("pip install 'mavdem[serve]'.")
        assert dashboard.view is not None
    viewer.close.assert_called_once_with()


def test_without_both_there_is_nothing_for_browsers(monkeypatch):
    without_modules(monkeypatch, "rerun", "starlette")
    with raises(MissingExtra, match=r"needs starlette: pip install 'mavdem\[serve\]'"):
        Dashboard("udpin:127.0.0.1:0", "roll", None, address=PageAddress(), connect=None)


def test_what_was_started_for_browsers_ends_where_the_page_cannot_be_served(monkeypatch):
    viewer = Mock()
    monkeypatch.setattr("mavdem.view.WebServer", Mock(return_value=viewer))
    taken = OSError("port 9090 of 127.0.0.1 is taken")
    monkeypatch.setattr("mavdem.serve.live_server.LiveServer", Mock(side_effect=taken))
    with raises(Unreadable, match="is taken"):
        Dashboard("udpin:127.0.0.1:0", "roll", None, address=PageAddress(), connect=None)
    viewer.close.assert_called_once_with()


@mark.slow
def test_a_second_session_has_its_page_at_another_port(monkeypatch):
    without_modules(monkeypatch, "rerun")
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken_port = other.getsockname()[1]
        monkeypatch.setattr(live_dashboard, "PAGE_PORT", taken_port)
        dashboard = Dashboard(
            "udpin:127.0.0.1:0", "roll", None, address=PageAddress(), connect=None
        )
        with closing(dashboard):
            assert "Open http://127.0.0.1:" in dashboard.advice
            assert f":{taken_port} " not in dashboard.advice


@mark.parametrize(
    ("words", "name"),
    [
        (("info", "FLIGHT.mcap"), "FLIGHT.mcap"),
        (("convert", str(LOG), "flight.mcap"), "flight.mcap"),
        (("convert", "FLIGHT.mcap", "flight.tlog"), "FLIGHT.mcap"),
        (("fly", "hover_blower", "--out", "flight.mcap"), "flight.mcap"),
        (("live", "udpin:127.0.0.1:0", "--record", "flight.mcap"), "flight.mcap"),
        (("review", str(LOG), "--mcap"), "flight.mcap"),
    ],
)
def test_without_the_libraries_of_mcap_a_recording_is_refused_in_one_sentence(
    words, name, here, monkeypatch, capsys
):
    """The package mcap is not installed: commands that read or write .mcap say so."""
    recording = here / "FLIGHT.mcap"
    recording.write_bytes(FORMAT_SIGNATURES[Format.MCAP].first_bytes)
    monkeypatch.setattr("mavdem.extras.find_spec", lambda name: None if name == "mcap" else name)
    assert main(list(words)) == 2
    out, error_output = capsys.readouterr()
    # A review says first what it reviews.
    assert not out and error_output.count("\n") <= 2
    assert error_output.endswith(f"{name} needs mcap: pip install 'mavdem[mcap]'.\n")
    assert list(here.iterdir()) == [recording]


def test_what_is_missing_is_a_fact_with_the_modules(monkeypatch):
    monkeypatch.setattr("mavdem.extras.find_spec", lambda name: None)
    for extra, modules in EXTRAS.items():
        with raises(MissingExtra) as refused:
            require_extra(extra, "flight.mcap")
        expected = Fact(
            PackageFact.EXTRA_MISSING, subject="flight.mcap", extra=extra, names=modules
        )
        assert refused.value.fact == expected


@mark.slow
def test_no_module_but_its_own_needs_an_extra(tmp_path):
    """What any command or ``import mavdem`` imports first is there in a core installation, which runs as a module.

    It writes all but the recordings, and the server begins, without Matplotlib.
    """
    (tmp_path / "flight.rrd").write_text("of a run before")
    words = [
        "learn",
        str(short_flight(tmp_path)),
        "--out",
        str(tmp_path),
        *QUICK,
        "--json",
    ]
    libraries = sorted({library for modules in EXTRAS.values() for library in modules})
    program = (
        "import runpy, sys\n"
        f"for name in {libraries}: sys.modules[name] = None\n"
        "import mavdem\n"
        "for name in mavdem.__all__: getattr(mavdem, name)\n"
        "from mavdem.cli import compare, convert, fly, info, learn, live, order, reproduce\n"
        f"from mavdem.cli.commands import main\nassert main({words}) == 0\n"
        f"for name in {libraries}: name == 'matplotlib' or sys.modules.pop(name)\n"
        "import mavdem.serve.app\n"
        "sys.argv[1:] = ['--version']; runpy.run_module('mavdem', run_name='__main__')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0 and "version" in done.stdout, done.stderr
    document, _ = json.JSONDecoder().raw_decode(done.stdout)
    written = {path.name for path in tmp_path.iterdir()} - {LOG.name}
    assert written == {*document["files"]} >= {"model.json", "report.json"}
    assert "flight.rrd" not in written


@mark.slow
def test_an_environment_of_another_checkout_is_refused_and_stays(tmp_path):
    (tmp_path / "pyvenv.cfg").touch()
    (tmp_path / "checkout").write_text("/another/checkout\n")
    done = subprocess.run(
        [Path(__file__).parents[1] / "tools" / "environment"],
        env={**os.environ, "MAVDEM_VENV": str(tmp_path), "PYTHON": sys.executable},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    refusal = "was made for /another/checkout: name another folder in MAVDEM_VENV, or delete it."
    assert done.stderr == f"tools/environment: {tmp_path} {refusal}\n"
    assert (tmp_path / "pyvenv.cfg").exists()
