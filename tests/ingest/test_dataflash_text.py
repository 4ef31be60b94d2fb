"""DataFlash logs as text: codes are integers, and numbers may have decimal commas."""

from numpy.testing import assert_array_equal
from pytest import mark

from mavdem.assessment.autopilot_messages import reported_problems
from mavdem.assessment.inventory import inventory
from mavdem.facts.events import ReportedEvent
from mavdem.facts.sources import Flaw, Repair
from mavdem.ingest import read_log

DEFINITIONS = (
    "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"
    "FMT, 184, 13, ERR, QBB, TimeUS,Subsys,ECode\n"
    "FMT, 185, 12, EV, QB, TimeUS,Id\n"
    "FMT, 64, 35, PARM, QNf, TimeUS,Name,Value\n"
    "FMT, 91, 75, MSG, QZ, TimeUS,Message\n"
    "FMT, 72, 36, ATT, QffffffB, TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF\n"
    "FMT, 73, 36, RATE, Qff, TimeUS,RDes,R\n"
)


def attitude_lines(point=".", separator=", "):
    """Returns 50 text lines with the attitude, whose roll is -0.5°, 0.5°, 1.5° and so on."""
    lines = ""
    for row in range(50):
        numbers = ["0.1", f"{row - 0.5}", "0.25", "-0.75", "10.5", "11.5"]
        values = [f"{1_000_000 + 100_000 * row}", *numbers, "3"]
        lines += separator.join(["ATT", *(value.replace(".", point) for value in values)]) + "\n"
    return lines


def text_log(folder, content):
    path = folder / "flight.log"
    path.write_text(DEFINITIONS + content)
    return read_log(path)


def test_errors_and_events_of_a_text_log_are_reported(tmp_path):
    log = text_log(tmp_path, attitude_lines() + "ERR, 1150000, 5, 1\nEV, 1160000, 17\n")
    inventory(log)
    problems = reported_problems(log.vehicles[0])
    assert problems[0].code is ReportedEvent.RADIO_LOST
    assert problems[0].figures["error_code"] == 1
    events = log.vehicles[0].messages["EV"]["Id"]
    assert events.dtype.kind == "i" and events.tolist() == [17]


@mark.parametrize(
    "broken", ["ERR, 1150000, 5.5, 1", "ERR, 1150000, nan, 1", "ERR, 1150000, 1e30, 1"]
)
def test_a_code_that_is_no_integer_is_left_out(broken, tmp_path):
    log = text_log(tmp_path, attitude_lines() + f"{broken}\nERR, 1250000, 5, 1\n")
    assert log.vehicles[0].messages["ERR"]["Subsys"].tolist() == [5]
    (repair,) = [
        fact for fact in log.vehicles[0].repairs if fact.code is Repair.LOGGED_MESSAGES_LEFT_OUT
    ]
    assert (repair.figures["count"], repair.figures["flaw"]) == (1, Flaw.UNREADABLE_NUMBER)


def test_a_definition_that_makes_a_code_a_fraction_hides_it(tmp_path):
    path = tmp_path / "flight.log"
    path.write_text((DEFINITIONS + attitude_lines()).replace("QBB", "Qff") + "ERR, 1150000, 5, 1\n")
    assert "ERR" not in read_log(path).vehicles[0].messages


@mark.parametrize("separator", [", ", ","])
def test_decimal_commas_are_read_as_points(separator, tmp_path):
    content = attitude_lines(",", separator)
    content += separator.join(["PARM", "1000000", "GAIN", "0,25"]) + "\n"
    content += separator.join(["MSG", "1000000", "Frame: QUAD, or so"]) + "\n"
    vehicle = text_log(tmp_path, content).vehicles[0]
    plain = text_log(tmp_path, attitude_lines()).vehicles[0]
    assert vehicle.parameters == {"GAIN": 0.25}
    assert vehicle.messages["STATUSTEXT"]["text"].tolist() == ["Frame: QUAD, or so"]
    for name, columns in plain.messages["ATTITUDE_TARGET"].items():
        assert_array_equal(vehicle.messages["ATTITUDE_TARGET"][name], columns)
    assert len(plain.messages["ATTITUDE_TARGET"]["time"]) == 50


def test_a_comma_that_may_be_either_leaves_the_line_out(tmp_path):
    content = attitude_lines() + "ATT,9000000,0,1,2,3,4,5,6,7,8,3\n"
    assert len(text_log(tmp_path, content).vehicles[0].messages["ATTITUDE_TARGET"]["time"]) == 50
