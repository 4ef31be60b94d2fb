"""The heading of a flight's page is short, and its details are below it."""

from pytest import mark

from mavdem.facts import Fact
from mavdem.facts.ending import Ending, FailedFirst
from mavdem.facts.session import SessionFact
from mavdem.facts.witnesses import HeightSource
from mavdem.report.heading import (
    MAX_HEADING_LENGTH,
    MAX_LISTED_LENGTH,
    heading_of,
    listed_headline,
    listed_next_step,
)

SPENT_THRUST = Fact(
    FailedFirst.THRUST_SPENT_FIRST,
    time=199.3,
    share=0.93,
    limited_names=["motor 1 (front right)"],
    limited_since=195.0,
    first_command=0.68,
    last_command=0.77,
)
OF_ONE_FLIGHT = {"last_number": None, "duration": None, "is_lost_in_air": False}
CRASH = Fact(
    Ending.CRASHED,
    time=201.0,
    cause=SPENT_THRUST,
    word=None,
    height=None,
    speed=1.3,
    speed_source=HeightSource.ESTIMATE,
)
FINDING = "Hit the ground at 201.0 s, falling at 1.3 m/s: all motors together worked at 93 % of their limit."


def test_a_long_headline_of_a_crash_is_its_cause_in_short_with_all_of_it_below():
    finding, details = heading_of(CRASH, CRASH.sentence)
    assert finding == FINDING and len(finding) <= MAX_HEADING_LENGTH
    assert details == str(SPENT_THRUST)
    verdict = Fact(SessionFact.FLIGHT_VERDICT, reason=CRASH, number=2, **OF_ONE_FLIGHT)
    finding, details = heading_of(verdict, verdict.sentence)
    assert finding == f"Flight 2: h{FINDING[1:]}" and details == str(SPENT_THRUST)


def test_what_measured_a_height_is_left_out_first_unless_satellites_contradict_it():
    motor = "motor 1 (front right)"
    loss = Fact(
        Ending.CONTROL_LOST,
        time=70.9,
        height=13.0,
        height_source=HeightSource.ESTIMATE,
        word=None,
        cause=Fact(FailedFirst.LIMIT_FIRST, subject=motor, assumed=True),
    )
    assert heading_of(loss, loss.sentence).finding == loss.sentence.replace(
        " by the autopilot's estimate", ""
    )
    contradicted = loss.replace(satellite_height=2.0)
    assert heading_of(contradicted, contradicted.sentence).finding == (
        "Lost control at 70.9 s, 13 m up by the autopilot's estimate, 2 m by satellites."
    )


@mark.parametrize(
    "text, finding, details",
    [
        ("Short: it stays.", "Short: it stays.", ""),
        (f"{'A' * 60}; {'b' * 40}: {'c' * 40}.", f"{'A' * 60}; {'b' * 40}.", f"C{'c' * 39}."),
        (f"{'A' * 60} ({'b' * 40}: {'c' * 40}).", f"{'A' * 60} ({'b' * 40}: {'c' * 40}).", ""),
    ],
)
def test_another_headline_is_divided_after_the_last_clause_that_fits(text, finding, details):
    assert heading_of(Fact(SessionFact.FLIGHT_VERDICT), text) == (finding, details)


WEAK_MOTOR = (
    "Motor 1 (front right) lost about 25 % of its thrust (20 to 29 %; motor or propeller) with "
)


@mark.parametrize(
    "text, listed",
    [
        (
            f"{WEAK_MOTOR}probability 0.96: it then works 15 % (12 to 19 %) harder than in 3 healthy flights.",
            "Motor 1 (front right) lost about 25 % of its thrust with probability 0.96: it then works 15 % harder "
            "than in 3 healthy flights.",
        ),
        (
            "All motors work 8 % harder than in 3 healthy flights (probability 0.57): check the load, then all "
            "propellers. The balance differs with probability 0.09.",
            "All motors work 8 % harder than in 3 healthy flights (probability 0.57): check the load, then all "
            "propellers.",
        ),
        (
            "Lost control at 143.1 s, 28 m up by the barometer, 12 m by satellites: motor 2 (rear left) did not hold "
            "the vehicle, although it was commanded to 89 %.",
            "Lost control at 143.1 s, 28 m up by the barometer, 12 m by satellites: motor 2 (rear left) did not hold "
            "the vehicle.",
        ),
        (
            "Lost control at 100.4 s, 9 m up by the autopilot's estimate: the autopilot stopped the motors in the air "
            "at 100.1 s: the remote control was lost.",
            "Lost control at 100.4 s, 9 m up: the autopilot stopped the motors in the air at 100.1 s: the remote "
            "control was lost.",
        ),
        (
            "Hit the ground at 630.0 s, falling at 4.3 m/s by the autopilot's estimate: it sank at full throttle, with "
            "motor 2 (rear left) and motor 4 (rear right) at the limit.",
            "Hit the ground at 630.0 s, falling at 4.3 m/s: it sank at full throttle, with motor 2 (rear left) and "
            "motor 4 (rear right) at the limit.",
        ),
        (
            "Vibration 15.7 m/s² on IMU 2 (axis z; above 15.0), no clips.",
            "Vibration 15.7 m/s² on IMU 2 (axis z; above 15.0), no clips.",
        ),
    ],
)
def test_a_headline_in_a_list_keeps_cause_size_probability_and_the_place_of_a_motor(text, listed):
    assert listed_headline(text) == listed and len(listed) <= MAX_LISTED_LENGTH


@mark.parametrize(
    "step",
    ["Do not fly. Check the battery (71 mΩ).", "Align all arms; then compare propellers and ESCs."],
)
def test_a_next_step_in_a_list_ends_with_an_action_in_full(step):
    assert listed_next_step(f"{step} Also balance the propellers.") == step
    assert listed_next_step(step) == step and listed_next_step("Do not fly.") == "Do not fly."
