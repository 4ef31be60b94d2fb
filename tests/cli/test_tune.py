"""``mavdem tune``: margins and gains of a simulated flight, its files, and refusals."""

from unittest.mock import Mock

from command_line import document_of, run, unwrapped
from pytest import mark
from recorded_flights import FLIGHT

from mavdem.ingest.parameter_file import read_parameters
from sitl_scenarios.files import load, scenario_toml

pytestmark = [mark.slow, mark.usefixtures("coarse_physics")]


@mark.usefixtures("logs_read_once")
def test_margins_gains_and_files_say_the_same_and_refusals_write_the_page_alone(
    tmp_path, capsys, monkeypatch
):
    """The gains in the document, in the file for the ground station and on the page agree."""
    log = str(tmp_path / "flight.tlog")
    out = tmp_path / "out"
    flown = load("iris_identification")
    slower = flown.vehicle.model_copy(update={"parameters": {"IMU_GYRO_RATEMAX": 100.0}})
    flown = flown.model_copy(update={"duration": 50.0, "vehicle": slower})
    (tmp_path / "slower.toml").write_text(scenario_toml(flown))
    assert run("fly", tmp_path / "slower.toml", "--out", log) == 0
    capsys.readouterr()
    assert run("tune", log, "--start", "45") == 1
    assert "smaller --start" in unwrapped(capsys.readouterr().out)
    document = document_of(capsys, "tune", FLIGHT, "--axis", "pitch", "--out", out, code=1)
    assert "no rate setpoint" in document["error"]["reason"]
    assert "rate setpoint" in document["next_step"]
    page = (out / "tune.html").read_text()
    assert "no rate setpoint" in page and "gains in the log" in page
    assert [file.name for file in out.iterdir()] == ["tune.html"]
    arguments = ["tune", log, "--margins", "soft", "--start", "5", "--out", out]
    tuning_document = document_of(capsys, *arguments, "--more")
    roll = tuning_document["axes"]["roll"]
    gains = tuning_document["parameters"]
    assert tuning_document["notch"] is None and not roll["filters"]["notches"]
    assert 80 < roll["loop"]["measured"]["agreement"] <= 100 and roll["sure"] >= 0.95 and gains
    written = out / "gains.stage1.params"
    assert read_parameters(written) == gains
    assert written.read_text().count("\t9\n1\t1\t") == len(gains) - 1
    flown_gains = read_parameters(out / "gains.before.params")
    assert flown_gains.keys() == gains.keys() and flown_gains != gains
    page = (out / "tune.html").read_text()
    assert page.count('<figure class="chart"') == 16 and 'class="headline"' in page
    assert "Stage 1, rate P, I and D" in page and roll["stage"] == 1
    # What to do stands first, then the gains with their files, then what they lead to.
    assert page.index("Next:") < page.index('download="') < page.index("Goal reached")
    monkeypatch.setattr("mavdem.cli.tune.tune_page", Mock(return_value=""))
    assert run(*arguments) == 0
    # No gains of the run before remain.
    assert [file.name for file in out.iterdir()] == ["tune.html"]


WEAKENED = """
seed = 61
duration = 50.0
height = 3.0
vehicle = { model = "iris", weak_motor = 1, weak_from = 28.0, weak_thrust = 0.8, parameters.SCHED_LOOP_RATE = 100.0 }
wind = [{ kind = "dryden", speed = 5.0 }]
excitation = { kind = "steps", distance = 2.0, period = 6.0 }
stream = { autopilot = "ardupilot", rate = 50.0 }
"""


def test_a_weak_motor_is_named_before_the_loops_and_in_the_place_of_gains(tmp_path, capsys):
    log = str(tmp_path / "flight.tlog")
    (tmp_path / "weakened.toml").write_text(WEAKENED)
    assert run("fly", tmp_path / "weakened.toml", "--out", log) == 0
    assert run("tune", log, "--more") == 1
    output = unwrapped(capsys.readouterr().out)
    # What is wrong with the vehicle comes before its loops.
    assert output.lower().startswith("motor 1")
    assert "Roll: no gains before the repair." in output and "Next: Do not fly" in output


SHAKEN = """
seed = 5
duration = 26.0
height = 3.0
vehicle = { parameters = { INS_GYRO_FILTER = 100.0 } }
shaking = { gyro = 0.03 }
wind = [{ kind = "dryden", speed = 4.0 }]
excitation = { kind = "doublets", amplitude = 6.0 }
stream = { autopilot = "ardupilot", rates = { HIGHRES_IMU = 400, ATTITUDE_TARGET = 100 } }
"""


@mark.usefixtures("without_pages")
def test_filters_are_written_with_the_gains_when_asked_for(tmp_path, capsys):
    """The simulated vehicle vibrates, so that a notch filter is advised."""
    (tmp_path / "shaken.toml").write_text(SHAKEN)
    log = str(tmp_path / "flight.tlog")
    assert run("fly", tmp_path / "shaken.toml", "--out", log) == 0
    capsys.readouterr()
    out = tmp_path / "out"
    document = document_of(capsys, "tune", log, "--filters", "--out", out)
    settings = dict(document["notch"]["figures"]["settings"])
    assert settings["INS_HNTCH_ENABLE"] == 1 and settings.items() <= document["parameters"].items()
    assert 0 < document["notch"]["figures"]["phase_cost"] < 3
    (written,) = out.glob("gains.*.params")
    assert "INS_HNTCH_FREQ" in written.read_text()
    assert document["axes"]["roll"]["filters"]["notches"]
