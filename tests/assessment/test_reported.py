"""What the autopilot reports, as facts, by made-up streams; of recorded flights the golden figures have them."""

from dataclasses import replace

import numpy as np
from hover import Hover, changed, columns, with_texts
from pytest import mark

from mavdem.assessment.autopilot_messages import reported_problems
from mavdem.assessment.lights.power import BOARD_VOLTAGE_LIMITS
from mavdem.assessment.repeated_reports import REPEAT_SECONDS, merge_repeats
from mavdem.assessment.reported import reported_events
from mavdem.dataset.signals import Signals
from mavdem.facts.events import ReportedEvent
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.vocabulary import NO_SEVERITY

HOVER = Hover()
FLOWN = HOVER.telemetry(10.0, 10.0)
CLIMB = -FLOWN.messages["LOCAL_POSITION_NED"]["vz"]
FLOWN = changed(FLOWN, "LOCAL_POSITION_NED", z=-np.cumsum(CLIMB) / 10.0)


def events(telemetry, *codes):
    """The events of these codes."""
    return [fact for fact in reported_events(Signals(telemetry)) if fact.code in codes]


TEXTS = {
    "PreArm: Need Position Estimate": (ReportedEvent.ARMING_REFUSED, "good", ""),
    "[health_and_arming_checks] Preflight Fail: Attitude failure (roll)": (
        ReportedEvent.ATTITUDE_FAILED,
        "bad",
        "roll",
    ),
    "Preflight Fail: horizontal position unstable": (ReportedEvent.ARMING_REFUSED, "good", ""),
    "Potential Thrust Loss (6)": (ReportedEvent.THRUST_LOST, "bad", "motor 6"),
    "Motor failure detected": (ReportedEvent.MOTOR_FAILED, "bad", ""),
    "Yaw Imbalance 98%": (ReportedEvent.YAW_IMBALANCED, "watch", ""),
    "Vibration compensation ON": (ReportedEvent.VIBRATION_COMPENSATED, "watch", ""),
    "Altitude failure": (ReportedEvent.ALTITUDE_FAILED, "bad", ""),
    "Crash: Disarming: AngErr=75>30, Accel=1.2<3.0": (ReportedEvent.CRASH_DETECTED, "bad", ""),
    "Parachute: Released": (ReportedEvent.PARACHUTE_RELEASED, "bad", ""),
    "Critical failure detected: terminating flight": (ReportedEvent.FLIGHT_TERMINATED, "bad", ""),
    "Kill-switch engaged": (ReportedEvent.MOTORS_STOPPED, "watch", ""),
    "EKF3 primary changed:1": (ReportedEvent.ESTIMATOR_SWITCHED, "watch", "lane 1"),
    "EKF variance": (ReportedEvent.ESTIMATOR_DIVERGED, "watch", ""),
    "EKF2 IMU0 ground mag anomaly, yaw re-aligned": (ReportedEvent.ESTIMATOR_RESET, "good", "yaw"),
    "EKF3 IMU0 emergency yaw reset": (ReportedEvent.ESTIMATOR_RESET, "watch", "yaw"),
    "EKF3 IMU1 stopped aiding": (ReportedEvent.ESTIMATOR_RESET, "watch", ""),
    "GPS Glitch": (ReportedEvent.GPS_JUMPED, "watch", ""),
    "GPS fix lost": (ReportedEvent.GPS_LOST, "watch", ""),
    "Accel #0 fail:  TIMEOUT!": (ReportedEvent.SENSOR_FAILED, "watch", "accel"),
    "Radio Failsafe": (ReportedEvent.RADIO_LOST, "watch", ""),
    "GCS Failsafe": (ReportedEvent.GROUND_STATION_LOST, "watch", ""),
    "Battery 1 is low 10.50V used 1500 mAh": (ReportedEvent.BATTERY_WARNED, "watch", "battery 1"),
    "Battery 1 is critical 10.1V": (ReportedEvent.BATTERY_ALARMED, "bad", "battery 1"),
    "Fence Breached": (ReportedEvent.FENCE_BREACHED, "watch", ""),
    "Failsafe activated": (ReportedEvent.FAILSAFE, "watch", ""),
    "Internal Error 0x1000": (ReportedEvent.AUTOPILOT_ERROR, "watch", "internal error"),
}


@mark.parametrize("text", TEXTS)
def test_texts_of_the_autopilot_become_facts_with_code_level_and_subject(text):
    (fact,) = reported_problems(with_texts(FLOWN, text.encode(), severity=(NO_SEVERITY,)))
    assert (fact.code, fact.level, fact.subject) == TEXTS[text]
    assert fact.time == 1.0 and fact.figures["basis"] == ("STATUSTEXT",)


def test_a_warning_that_nobody_knows_is_quoted_and_what_is_no_warning_is_not():
    telemetry = with_texts(FLOWN, b"Toilet seat up", b"EKF3 active", severity=(4, 6))
    (fact,) = reported_problems(telemetry)
    assert (fact.code, fact.figures["text"]) == (ReportedEvent.AUTOPILOT_SAID, "Toilet seat up")
    assert fact.figures["severity"] == "warning"
    assert not reported_problems(with_texts(FLOWN, b"Radio Failsafe Cleared", severity=(4,)))
    assert not reported_problems(with_texts(FLOWN, b"Mission terminated"))
    # Severities had another scale.
    assert not reported_problems(
        with_texts(FLOWN, b"GROUND START", b"ARMING MOTORS", severity=(1, 3))
    )


def test_a_status_text_in_chunks_is_joined():
    telemetry = with_texts(FLOWN, b"Potential Thr", b"other", b"ust Loss (2)", severity=(2, 6, 2))
    telemetry = changed(telemetry, "STATUSTEXT", id=[7, 0, 7], chunk_seq=[0, 0, 1])
    (fact,) = reported_problems(telemetry)
    assert (fact.code, fact.subject, fact.time) == (ReportedEvent.THRUST_LOST, "motor 2", 1.0)


def test_repeated_reports_are_one_event_with_count_and_interval():
    times = np.array([1.0, 1.0 + REPEAT_SECONDS, 1.1 + 2 * REPEAT_SECONDS])
    glitches = columns(times, text=b"GPS Glitch", severity=4)
    problems = merge_repeats(reported_problems(changed(FLOWN, "STATUSTEXT", **glitches)))
    spans = [(fact.time, fact.end_time, fact.figures["count"]) for fact in problems]
    assert spans == [(1.0, 1.0 + REPEAT_SECONDS, 2), (times[2], None, 1)]


@mark.parametrize(
    "texts, end_times, is_over",
    [
        ([b"GPS Glitch", b"Glitch cleared"], [2.0], True),
        ([b"Radio Failsafe", b"GPS Glitch", b"Radio Failsafe Cleared"], [3.0, None], False),
        ([b"GPS Glitch", b"Glitch cleared", b"GPS Glitch"], [3.0], False),
    ],
)
def test_a_text_ends_the_problem_that_it_says_is_over(texts, end_times, is_over):
    telemetry = with_texts(FLOWN, *texts, severity=[4] * len(texts))
    problems = merge_repeats(reported_problems(telemetry))
    assert [problem.end_time for problem in problems] == end_times
    assert problems[-1].figures.get("is_over", False) is is_over


@mark.parametrize(
    "second_loss, spans", [(20.0, [(10.0, 11.0), (20.0, 30.0)]), (15.0, [(10.0, 30.0)])]
)
def test_a_state_that_was_over_is_not_reported_through_the_pause(second_loss, spans):
    """GPS is lost from 10 s to 11 s, and again after a long or short pause."""
    gps_failsafe = 7
    rows = columns([10.0, 11.0, second_loss, 30.0], Subsys=[gps_failsafe] * 4, ECode=[1, 0, 1, 0])
    problems = merge_repeats(reported_problems(changed(FLOWN, "ERR", **rows)))
    assert [(fact.code, fact.time, fact.end_time) for fact in problems] == [
        (ReportedEvent.GPS_LOST, start, end) for start, end in spans
    ]


def test_of_two_equal_reports_the_worse_level_holds():
    error_events = columns([0.5], Id=[62])
    telemetry = with_texts(changed(FLOWN, "EV", **error_events), b"EKF3 IMU0 emergency yaw reset")
    (fact,) = merge_repeats(reported_problems(telemetry))
    assert (fact.time, fact.level, fact.subject) == (0.5, "watch", "yaw")
    assert fact.figures["basis"] == ("EV", "STATUSTEXT")


def test_a_filter_that_the_autopilot_doubts_may_only_lack_a_position():
    (fact,) = reported_problems(changed(FLOWN, "ERR", **columns([30.0], Subsys=[16], ECode=[2])))
    assert "or has no position (EKF variance)" in fact.sentence


def test_a_glitch_of_the_barometer_is_no_failed_sensor():
    errors = columns([30.0, 50.0], Subsys=[18, 18], ECode=[2, 4])
    glitch, failure = reported_problems(changed(FLOWN, "ERR", **errors))
    assert glitch.sentence == "The autopilot reports a jump of the barometer (glitch)."
    assert failure.sentence == "The autopilot reports that a sensor failed: barometer."


def test_errors_of_dataflash_have_their_name_and_last_until_they_are_over():
    """ArduPilot's ERR has numbers of a subsystem and an error; code 0 ends the error of that subsystem."""
    rows = columns(
        [30.0, 31.0, 34.0, 40.0, 50.0],
        Subsys=[16, 5, 5, 13, 24],
        ECode=[2, 1, 0, 2, 0],
    )
    event_codes = columns([45.0], Id=[51])
    telemetry = changed(changed(FLOWN, "ERR", **rows), "EV", **event_codes)
    problems = merge_repeats(reported_problems(telemetry))
    assert [(fact.code, fact.time, fact.end_time) for fact in problems] == [
        (ReportedEvent.ESTIMATOR_DIVERGED, 30.0, None),
        (ReportedEvent.RADIO_LOST, 31.0, 34.0),
        (ReportedEvent.AUTOPILOT_ERROR, 40.0, None),
        (ReportedEvent.PARACHUTE_RELEASED, 45.0, None),
        (ReportedEvent.ESTIMATOR_SWITCHED, 50.0, None),
    ]
    assert {fact.figures.get("severity") for fact in problems} == {"error", None}
    assert problems[2].subject == "flip" and problems[2].figures["error_code"] == 2
    assert problems[4].subject == "lane 0"


@mark.slow
def test_the_land_detector_dates_the_take_off_of_what_climbed():
    landed = columns([0.0, 5.0, 6.2, 70.0, 75.0], landed_state=[1, 1, 2, 2, 1])
    (up,) = events(changed(FLOWN, "EXTENDED_SYS_STATE", **landed), ReportedEvent.OFF_GROUND)
    assert (up.time, up.figures["basis"]) == (6.2, ("EXTENDED_SYS_STATE",))
    held = changed(FLOWN, "LOCAL_POSITION_NED", vz=-0.01 * CLIMB)
    assert not events(held, ReportedEvent.OFF_GROUND)


def test_a_change_of_mode_has_ardupilots_reason_and_its_level():
    modes = columns([5.0, 20.0, 30.0], custom_mode=[5.0, 6.0, 9.0], Rsn=[1, 3, 17])
    mode_changes = events(changed(FLOWN, "CURRENT_MODE", **modes), ReportedEvent.MODE_CHANGED)
    assert [(fact.subject, fact.figures["cause"], fact.level) for fact in mode_changes] == [
        ("Loiter", "pilot", "good"),
        ("RTL", "radio failsafe", "watch"),
        ("Land", "termination", "bad"),
    ]


def test_a_change_of_mode_in_px4_has_the_failsafe_or_the_sender_as_its_cause():
    """By the companion at 10 s, a ground station at 20 s, PX4 itself at 30 s, the pilot at 40 s, a failsafe at 50 s."""
    modes = 65536.0 * np.arange(1.0, 8.0)
    telemetry = changed(
        FLOWN, "CURRENT_MODE", **columns([0.0, 10, 20, 30, 40, 50, 60], custom_mode=modes)
    )
    # The command at 59 s does not change the mode, and the one at 55 s is too early for the mode at 60 s.
    commands = columns(
        [9.9, 19.9, 29.9, 55.0, 59.9],
        command=[176, 20, 20, 20, 400],
        source_system=[1, 255, 1, 1, 255],
        source_component=[191, 190, 1, 1, 190],
        from_external=[1, 1, 0, 0, 1],
    )
    telemetry = changed(telemetry, "vehicle_command", **commands)
    # Arming and a mode are asked for by switches.
    requests = columns([15.0, 39.9], action=[1, 5])
    telemetry = changed(telemetry, "action_request", **requests)
    beats = FLOWN.messages["HEARTBEAT"]["time"]
    telemetry = changed(telemetry, "HEARTBEAT", system_status=4 + (abs(beats - 52) <= 2))
    mode_changes = events(telemetry, ReportedEvent.MODE_CHANGED)
    assert [(fact.figures["cause"], fact.level) for fact in mode_changes] == [
        ("", "good"),
        ("command of a companion computer, component 191", "good"),
        ("command of a ground station", "good"),
        ("command of the autopilot itself", "good"),
        ("pilot", "good"),
        ("failsafe", "watch"),
        ("", "good"),
    ]


TIMES = np.arange(0.0, 76.0)
LOST = (TIMES >= 20.0) & (TIMES <= 24.0)
STATES = {
    "GPS_RAW_INT": ("fix_type", 3, 1, ReportedEvent.GPS_LOST),
    "input_rc": ("rc_lost", 0, 1, ReportedEvent.RADIO_LOST),
    "POWER_STATUS": (
        "Vcc",
        1000 * BOARD_VOLTAGE_LIMITS.bad,
        1000 * BOARD_VOLTAGE_LIMITS.bad - 1,
        ReportedEvent.BOARD_VOLTAGE_LOW,
    ),
    "SYS_STATUS": ("charge_state", 1, 2, ReportedEvent.BATTERY_WARNED),
    "BATTERY_STATUS": ("charge_state", 1, 3, ReportedEvent.BATTERY_ALARMED),
}
DETECTED = {
    "fd_pitch": (ReportedEvent.ATTITUDE_FAILED, "bad", "pitch"),
    "fd_imbalanced_prop": (ReportedEvent.PROPELLER_IMBALANCED, "watch", ""),
    "motor_failure_mask": (ReportedEvent.MOTOR_FAILED, "bad", "motor 3"),
}


@mark.parametrize("message", STATES)
def test_faults_while_armed_have_start_and_end(message):
    field, sound, bad, code = STATES[message]
    telemetry = changed(FLOWN, message, **columns(TIMES, **{field: np.where(LOST, bad, sound)}))
    (fact,) = events(telemetry, code)
    level = "bad" if code is ReportedEvent.BATTERY_ALARMED else "watch"
    assert (fact.time, fact.end_time, fact.level) == (20.0, 24.0, level)
    on_ground = columns(TIMES, **{field: np.where(TIMES < 4.0, bad, sound)})
    assert not events(changed(FLOWN, message, **on_ground), code)


def test_a_fix_that_a_boot_has_not_had_yet_is_not_lost():
    # The boot of the flight has no fix at first. Another boot, before it, had one.
    fix_types = np.where(TIMES < 24.0, 1, 3)
    receiver = columns(
        np.concatenate([TIMES, TIMES]),
        boot=np.repeat([-1, 0], len(TIMES)),
        fix_type=np.concatenate([0 * TIMES + 3, fix_types]),
    )
    assert not events(changed(FLOWN, "GPS_RAW_INT", **receiver), ReportedEvent.GPS_LOST)


@mark.slow
def test_a_fix_is_not_lost_while_the_second_receiver_has_one():
    first = columns(TIMES, fix_type=np.where(LOST, 1, 3))
    telemetry = changed(FLOWN, "GPS_RAW_INT", **first)
    assert events(telemetry, ReportedEvent.GPS_LOST)
    for fix_type, count in ((3, 0), (1, 1)):
        second = columns(TIMES + 0.1, fix_type=0 * TIMES + fix_type)
        assert (
            len(events(changed(telemetry, "GPS2_RAW", **second), ReportedEvent.GPS_LOST)) == count
        )


def test_a_lost_fix_names_the_receiver_that_was_recorded():
    messages = {name: table for name, table in FLOWN.messages.items() if name != "GPS_RAW_INT"}
    second = columns(TIMES, fix_type=np.where(LOST, 1, 3))
    telemetry = changed(replace(FLOWN, messages=messages), "GPS2_RAW", **second)
    (lost,) = events(telemetry, ReportedEvent.GPS_LOST)
    assert lost.figures["basis"] == ("GPS2_RAW",)


def test_a_fix_that_is_missing_when_the_motors_stop_has_no_end():
    receiver = columns(TIMES, fix_type=np.where(TIMES >= 20.0, 1, 3))
    (lost,) = events(changed(FLOWN, "GPS_RAW_INT", **receiver), ReportedEvent.GPS_LOST)
    assert (lost.time, lost.end_time) == (20.0, None)


@mark.parametrize("field", DETECTED)
def test_faults_of_px4s_failure_detector_become_events(field):
    code, level, subject = DETECTED[field]
    detected = columns(TIMES, **{field: LOST * (4 if "mask" in field else 1)})
    (fact,) = events(changed(FLOWN, "failure_detector_status", **detected), code)
    assert (fact.level, fact.subject, fact.time, fact.end_time) == (level, subject, 20.0, 24.0)


def test_reports_while_disarmed_are_not_bad():
    telemetry = with_texts(FLOWN, b"Preflight Fail: Attitude failure (roll)")
    (fact,) = events(telemetry, ReportedEvent.ATTITUDE_FAILED)
    assert fact.level == "watch"
    late = changed(telemetry, "STATUSTEXT", time=np.array([HOVER.landed]))
    (fact,) = events(late, ReportedEvent.ATTITUDE_FAILED)
    assert fact.level == "bad"


@mark.slow
def test_a_failsafe_and_a_lane_are_states_too():
    """A failsafe lasts from 31 s to 39 s, the estimator switches lanes twice, and resets at 30 s."""
    beats = FLOWN.messages["HEARTBEAT"]["time"]
    critical = 4 + (abs(beats - 35) < 5)
    telemetry = changed(FLOWN, "HEARTBEAT", system_status=critical)
    (fact,) = events(telemetry, ReportedEvent.FAILSAFE)
    assert (fact.time, fact.end_time) == (31.0, 39.0)
    lanes = columns(TIMES, primary_instance=1 * LOST)
    switched = changed(FLOWN, "estimator_selector_status", **lanes)
    switches = events(switched, ReportedEvent.ESTIMATOR_SWITCHED)
    assert [(fact.time, fact.subject) for fact in switches] == [(20.0, "lane 1"), (25.0, "lane 0")]
    # The selector tries lanes 0 and 2 before it stays with lane 1.
    tried = columns(np.array([20.0, 20.01, 20.02, 20.03, 40.0]), primary_instance=[1, 0, 2, 1, 1])
    switched = changed(FLOWN, "estimator_selector_status", **tried)
    text = "primary EKF changed {} (filter fault) -> {}"
    texts = [text.format(1, 0), text.format(0, 2), text.format(2, 1)]
    messages = columns([20.01, 20.02, 20.03], text=texts, severity=[4, 4, 4])
    (fact,) = events(changed(switched, "STATUSTEXT", **messages), ReportedEvent.ESTIMATOR_SWITCHED)
    assert (fact.time, fact.subject, fact.figures["cause"]) == (20.03, "lane 1", "filter fault")
    resets = 255 * (np.arange(len(CLIMB)) < 300)
    telemetry = changed(FLOWN, "LOCAL_POSITION_NED", resets=resets)
    (fact,) = events(telemetry, ReportedEvent.ESTIMATOR_RESET)
    assert (fact.time, fact.level) == (30.0, "good")


@mark.slow
@mark.parametrize(
    "text, message, field, sound, faulty",
    [
        ("[failsafe] Failsafe activated", "HEARTBEAT", "system_status", 4, 5),
        ("Battery 1 is critical 10.1V", "BATTERY_STATUS", "charge_state", 2, 3),
        ("Motor failure detected", "failure_detector_status", "fd_motor", 0, 1),
    ],
)
def test_a_recorded_state_contradicts_or_confirms_a_text(text, message, field, sound, faulty):
    """The autopilot reports a fault by a text.

    A message with the state of the same system has the fault, or does not.
    """
    telemetry = with_texts(FLOWN, text.encode(), severity=(4,))
    telemetry = changed(telemetry, "STATUSTEXT", time=np.array([30.5]))
    (claim,) = reported_problems(telemetry)
    table = FLOWN.messages.get(message, {"time": TIMES, "boot": 0 * TIMES.astype(int)})

    def with_states(state_times, values):
        rows = {name: column[: len(state_times)] for name, column in table.items()}
        messages = {**telemetry.messages, message: {**rows, "time": state_times, field: values}}
        return replace(telemetry, messages=messages)

    times = table["time"]
    confirmed = with_states(times, np.where(times >= 31.0, faulty, sound))
    (fact,) = events(confirmed, claim.code, ReportedEvent.AUTOPILOT_SAID)
    assert fact.code is claim.code
    (fact,) = events(
        with_states(times, 0 * times.astype(int) + sound), claim.code, ReportedEvent.AUTOPILOT_SAID
    )
    assert fact.level == "watch" and "does not confirm" in fact.sentence and text in fact.sentence
    # A record of the state that ends before the text shows nothing.
    (fact,) = events(telemetry, claim.code, ReportedEvent.AUTOPILOT_SAID)
    assert fact.code is claim.code


@mark.parametrize(
    "text, last_of_second, is_contradicted",
    [
        ("Battery 1 is critical 10.1V", 40.0, True),
        ("Battery 2 is critical 10.1V", 40.0, True),
        ("Battery 2 is critical 10.1V", -1.0, False),
        ("Battery 3 is critical 10.1V", 40.0, False),
        ("Battery critical", 40.0, True),
        ("Battery critical", 20.0, False),
        ("Battery critical", -1.0, True),
    ],
)
def test_a_battery_contradicts_no_text_about_another(text, last_of_second, is_contradicted):
    """Batteries 1 and 2 report a sound state, the second up to some time, while a text names a battery."""
    telemetry = with_texts(FLOWN, text.encode(), severity=(4,))
    telemetry = changed(telemetry, "STATUSTEXT", time=np.array([30.5]))
    first, second = TIMES, TIMES[last_of_second >= TIMES]
    batteries = columns(
        np.r_[first, second],
        id=np.r_[0 * first, 0 * second + 1].astype(int),
        charge_state=np.ones(len(first) + len(second), int),
    )
    (fact,) = events(
        changed(telemetry, "BATTERY_STATUS", **batteries),
        ReportedEvent.BATTERY_ALARMED,
        ReportedEvent.AUTOPILOT_SAID,
    )
    assert (fact.code is ReportedEvent.AUTOPILOT_SAID) is is_contradicted


def test_a_sensor_that_is_used_and_not_healthy_failed():
    used = 1 << 3 | 1 << 16
    sensors = {"present": used, "enabled": used, "health": np.where(LOST, 1 << 16, used)}
    fields = {f"onboard_control_sensors_{name}": bits for name, bits in sensors.items()}
    telemetry = changed(FLOWN, "SYS_STATUS", **columns(TIMES, **fields))
    (fact,) = events(telemetry, ReportedEvent.SENSOR_FAILED, ReportedEvent.RADIO_LOST)
    assert (fact.subject, fact.time, fact.end_time) == ("barometer", 20.0, 24.0)


def test_a_radio_that_stays_lost_has_no_end_whatever_is_reported_meanwhile():
    radio = 1 << 16
    health = np.where(TIMES < 20.0, radio, 0)
    sensors = {"present": radio, "enabled": radio, "health": health}
    fields = {f"onboard_control_sensors_{name}": bits for name, bits in sensors.items()}
    telemetry = changed(FLOWN, "SYS_STATUS", **columns(TIMES, **fields))
    telemetry = with_texts(telemetry, b"Manual control lost", b"Manual control lost")
    telemetry = changed(telemetry, "STATUSTEXT", time=np.array([20.7, 41.0]))
    (fact,) = events(telemetry, ReportedEvent.RADIO_LOST)
    assert (fact.time, fact.end_time, fact.figures["count"]) == (20.0, None, 3)
    assert fact.sentence == "The remote control was lost."


def test_a_failsafe_that_ends_between_two_flights_is_not_that_of_the_next():
    """The vehicle is disarmed from 15 s to 25 s; the failsafe of the first flight ends meanwhile."""
    beats = FLOWN.messages["HEARTBEAT"]
    time = beats["time"]
    disarmed = (time >= 15.0) & (time < 25.0)
    next_start = 19.0 + REPEAT_SECONDS
    in_failsafe = (time >= 12.0) & (time <= 18.0) | (time >= next_start)
    telemetry = changed(
        FLOWN,
        "HEARTBEAT",
        base_mode=np.where(disarmed, 0, beats["base_mode"]),
        system_status=np.where(in_failsafe, 5, 4),
    )
    failsafes = events(telemetry, ReportedEvent.FAILSAFE)
    assert [(fact.time, fact.end_time) for fact in failsafes] == [(12.0, 18.0), (next_start, None)]


@mark.parametrize("pause, count", [(4.0, 1), (16.0, 2)])
def test_two_failsafes_of_one_flight_are_two_events(pause, count):
    time = FLOWN.messages["HEARTBEAT"]["time"]
    second_start = 15.0 + pause
    in_failsafe = (time >= 12.0) & (time <= 15.0) | (time >= second_start) & (time <= 34.0)
    telemetry = changed(FLOWN, "HEARTBEAT", system_status=np.where(in_failsafe, 5, 4))
    failsafes = events(telemetry, ReportedEvent.FAILSAFE)
    assert len(failsafes) == count
    assert (failsafes[0].time, failsafes[-1].end_time) == (12.0, 34.0)


@mark.parametrize("time, is_trigger", [(30.9, True), (28.5, False), (31.5, False)])
def test_what_is_reported_just_before_a_failsafe_is_its_trigger(time, is_trigger):
    beats = FLOWN.messages["HEARTBEAT"]["time"]
    telemetry = changed(FLOWN, "HEARTBEAT", system_status=4 + (abs(beats - 35) < 5))
    late = changed(
        with_texts(telemetry, b"Battery 1 low voltage"), "STATUSTEXT", time=np.array([time])
    )
    (fact,) = events(late, ReportedEvent.FAILSAFE)
    assert ("battery 1 is low" in fact.sentence) is is_trigger
    assert ("fresher battery" in fact.remedy) is is_trigger


def test_the_health_of_the_attitude_is_no_variance_of_the_filter():
    attitude = mavlink_constant("MAV_SYS_STATUS_AHRS")
    sensors = {"present": attitude, "enabled": attitude, "health": np.where(LOST, 0, attitude)}
    fields = {f"onboard_control_sensors_{name}": bits for name, bits in sensors.items()}
    (fact,) = events(
        changed(FLOWN, "SYS_STATUS", **columns(TIMES, **fields)), ReportedEvent.ESTIMATOR_DIVERGED
    )
    assert fact.sentence == "The autopilot reports that its attitude estimate is not healthy."


def test_a_sensor_that_was_never_healthy_did_not_fail():
    used = 1 << 3 | 1 << 16
    sensors = {"present": used, "enabled": used, "health": 1 << 16}
    fields = {f"onboard_control_sensors_{name}": bits for name, bits in sensors.items()}
    telemetry = changed(FLOWN, "SYS_STATUS", **columns(TIMES, **fields))
    assert not events(telemetry, ReportedEvent.SENSOR_FAILED)


def test_an_emergency_is_reported_beside_the_critical_battery_before_it():
    state = np.select([TIMES < 20.0, TIMES < 30.0], [1, 3], 4)
    telemetry = changed(FLOWN, "BATTERY_STATUS", **columns(TIMES, charge_state=state))
    critical, spent = events(telemetry, ReportedEvent.BATTERY_ALARMED, ReportedEvent.BATTERY_SPENT)
    assert (critical.code, critical.time) == (ReportedEvent.BATTERY_ALARMED, 20.0)
    assert (spent.code, spent.time, spent.level) == (ReportedEvent.BATTERY_SPENT, 30.0, "bad")
    assert spent.sentence == "The autopilot reports that the battery is at its end: emergency."


def test_motors_that_stop_high_in_the_air_are_no_landing():
    (landed,) = events(FLOWN, ReportedEvent.ON_GROUND)
    time = FLOWN.messages["LOCAL_POSITION_NED"]["time"]
    seconds_after = np.maximum(time - landed.time, 0.0)
    height = np.where(time < 5.0, 0.0, np.maximum(10.0 - 5 * seconds_after**2, 0.0))
    fallen = changed(FLOWN, "LOCAL_POSITION_NED", z=-height)
    assert not events(fallen, ReportedEvent.ON_GROUND)


@mark.parametrize("time, is_reported", [(7.2, False), (40.0, True)])
def test_a_landing_that_is_detected_high_in_a_flight_is_an_event(time, is_reported):
    """The vehicle is 2.4 m up at 7.2 s, and 10 m at 40 s."""
    landed = columns([0.0, 6.0, time, time + 0.2, 70.0], landed_state=[1, 2, 1, 2, 1])
    telemetry = changed(FLOWN, "EXTENDED_SYS_STATE", **landed)
    reports = events(telemetry, ReportedEvent.LANDING_DETECTED_IN_FLIGHT)
    assert [report.time for report in reports] == [time] * is_reported
    assert all("10 m above the take-off" in report.sentence for report in reports)


@mark.slow
def test_reports_of_the_ground_throughout_a_flight_are_an_event_and_hide_no_flight():
    stuck = changed(FLOWN, "EXTENDED_SYS_STATE", **columns(np.arange(0.0, 80.0), landed_state=1))
    (wrong,) = events(stuck, ReportedEvent.GROUND_REPORTED_IN_FLIGHT)
    assert (wrong.level, wrong.time, wrong.end_time) == ("watch", 0.0, 79.0)
    assert "10 m above the take-off" in wrong.sentence and "are not used" in wrong.sentence
    # The take-off is that of a log without the reports.
    (take_off,) = events(stuck, ReportedEvent.OFF_GROUND)
    assert take_off.time == events(FLOWN, ReportedEvent.OFF_GROUND)[0].time


def test_a_second_boot_is_a_restart():
    boot = (FLOWN.messages["HEARTBEAT"]["time"] > 40.0).astype(int)
    restarted = changed(FLOWN, "HEARTBEAT", boot=boot)
    (fact,) = events(restarted, ReportedEvent.RESTARTED)
    assert (fact.time, fact.figures["boot"], fact.level) == (41.0, 1, "watch")
    first, second = events(restarted, ReportedEvent.MOTORS_ARMED)
    assert first.sentence == "Armed."
    assert second.sentence == "Armed when the log goes on after the restart."
