"""Parameter files of QGroundControl and Mission Planner, and what a log takes of them."""

from command_line import refused
from pytest import mark
from recorded_flights import FLIGHT
from refusals import unreadable

from mavdem.facts.sources import Repair, SourceFact
from mavdem.ingest import read_log
from mavdem.ingest.parameter_file import read_parameters, with_parameters

FILES = {
    "QGroundControl": "# Onboard parameters\n#\n1\t1\tMC_ROLLRATE_P\t0.15\t9\n1\t1\tCA_AIRFRAME\t0\t6\n",
    "Mission Planner": "#NOTE: 1:2:3\nMC_ROLLRATE_P,0.15\nCA_AIRFRAME,0\n",
    "MAVProxy": "MC_ROLLRATE_P   0.150000\r\nCA_AIRFRAME 0\r\nNAN_HERE nan\r\n",
}


@mark.parametrize("station", FILES)
def test_each_ground_stations_file_is_read(station, tmp_path):
    path = tmp_path / "file"
    path.write_text(FILES[station], newline="")
    assert read_parameters(path) == {"MC_ROLLRATE_P": 0.15, "CA_AIRFRAME": 0.0}


@mark.slow
def test_the_logs_own_parameters_stay(tmp_path):
    path = tmp_path / "file.param"
    log = read_log(FLIGHT)
    name, value = next(iter(log.vehicles[0].parameters.items()))
    path.write_text(f"{name},{value + 1}\nMADE_UP,2\n")
    (vehicle,) = with_parameters(log, path).vehicles
    assert vehicle.parameters == {**log.vehicles[0].parameters, "MADE_UP": 2.0}
    assert vehicle.repairs[-1].code is Repair.PARAMETERS_ADDED
    assert vehicle.repairs[-1].figures["count"] == 1


@mark.slow
def test_a_file_without_parameters_is_refused(tmp_path, capsys):
    path = tmp_path / "file.param"
    path.write_text("no parameters here\n")
    assert unreadable(read_parameters, path).code is SourceFact.NO_PARAMETERS_IN_FILE
    assert str(path) in refused(capsys, 2, "tune", FLIGHT, "--params", path)
