"""Several instances of the state estimator: the one that flies is judged, a spare that rejects is to be watched."""

from dataclasses import replace

import dataflash_logs as made
import numpy as np
import pytest
from hover import Hover, changed, columns, evidence_of
from numpy.testing import assert_allclose, assert_array_equal

from mavdem.assessment.lights.estimator import estimator_light
from mavdem.assessment.reported import reported_events
from mavdem.dataset.signals import Signals
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.events import ReportedEvent
from mavdem.facts.sources import Repair
from mavdem.ingest import read_log
from mavdem.ingest.px4_instances import estimator_instances, estimator_status
from mavdem.ingest.vocabulary import INSTANCES_MESSAGE

HOVER = Hover()
TIME = HOVER.stamps(5.0)
REJECTING = (TIME > 30.0) & (TIME < 40.0)


def evidence(telemetry):
    return evidence_of(Signals(telemetry))


def two_instances(primary, rejecting):
    """The hover with a filter of two instances, of which one rejects position and compass for ten seconds."""
    telemetry = HOVER.telemetry(20.0, 20.0)
    ratios = {}
    for number in (0, 1):
        ratios[number] = np.where(REJECTING & (number == rejecting), 1.8, 0.1)
    telemetry = changed(
        telemetry,
        "EKF_STATUS_REPORT",
        **columns(
            TIME,
            flags=np.full(len(TIME), 831),
            velocity_variance=0.1 + 0 * TIME,
            pos_horiz_variance=ratios[primary],
            pos_vert_variance=0.1 + 0 * TIME,
            compass_variance=ratios[primary],
        ),
    )
    instance = np.tile([0, 1], len(TIME))
    ratio = np.column_stack([ratios[0], ratios[1]]).ravel()
    return changed(
        telemetry,
        INSTANCES_MESSAGE,
        **columns(
            np.repeat(TIME, 2),
            instance=instance,
            is_primary=(instance == primary).astype(int),
            velocity=0.1 + 0 * ratio,
            position=ratio,
            height=0.1 + 0 * ratio,
            compass=ratio,
        ),
    )


def test_the_instance_that_flies_is_judged_and_named():
    fact = estimator_light(evidence(two_instances(primary=1, rejecting=1)))
    assert (fact.code, fact.level) == (EstimatorLight.FILTER_DOUBTED, "bad")
    assert fact.subject == "core 1" and "(core 1)" in str(fact)


@pytest.mark.slow
def test_a_spare_instance_that_rejects_is_to_be_watched():
    fact = estimator_light(evidence(two_instances(primary=0, rejecting=1)))
    assert (fact.code, fact.level) == (EstimatorLight.SPARE_DOUBTED, "watch")
    assert fact.subject == "core 1" and fact.figures["name"] == "position"


def test_agreeing_instances_are_good():
    fact = estimator_light(evidence(two_instances(primary=0, rejecting=None)))
    assert (fact.level, fact.subject) == ("good", "core 0")


GLITCHING = 831 | 1 << 15


@pytest.mark.slow
@pytest.mark.parametrize(
    ("receiver", "parameters", "is_flagged"),
    [
        ({"fix_type": 3, "satellites_visible": 9}, {}, True),
        ({"fix_type": 1, "satellites_visible": 3}, {}, False),
        (None, {"GPS_TYPE": 0.0}, False),
        (None, {}, True),
    ],
)
def test_gps_is_doubted_only_with_a_position_fix(receiver, parameters, is_flagged):
    """The filter rejects GPS in flight: with a fix that is a fault, without a receiver it means nothing."""
    telemetry = HOVER.telemetry(20.0, 20.0, parameters=parameters)
    ratios = dict.fromkeys(
        ("velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance"), 0.1
    )
    flags = np.where(REJECTING, GLITCHING, 831)
    status = columns(TIME, flags=flags, **ratios)
    telemetry = changed(telemetry, "EKF_STATUS_REPORT", **status)
    error = columns(np.array([31.0]), Subsys=np.array([11]), ECode=np.array([2]))
    telemetry = changed(telemetry, "ERR", **error)
    if receiver is not None:
        fields = {name: np.full(len(TIME), value) for name, value in receiver.items()}
        telemetry = changed(telemetry, "GPS_RAW_INT", **columns(TIME, **fields))
    fact = estimator_light(evidence(telemetry))
    assert (fact.code is EstimatorLight.GPS_DOUBTED) == is_flagged
    reports = [event.code for event in reported_events(Signals(telemetry))]
    assert (ReportedEvent.GPS_JUMPED in reports) == is_flagged


MOTION = "TimeUS,C,VN,VE,VD,PN,PE,PD"
STATUS = "TimeUS,C,SV,SP,SH,SM,SS,PI"


def estimates(monkeypatch, rows, names=("XKF1", "XKF4"), fields=(MOTION, STATUS)):
    """Defines the messages of a filter for the test, and returns rows of them: pairs of a name and values."""
    for kind, name, names_of_fields in zip((160, 161), names, fields, strict=True):
        count = names_of_fields.count(",")
        has_core = ",C," in names_of_fields
        characters = "Q" + ("B" if has_core else "") + "f" * (count - has_core)
        monkeypatch.setitem(made.MESSAGES, name, (kind, characters, names_of_fields))
    return [made.message(name, *values) for name, values in rows]


def vehicle_with(tmp_path, rows):
    path = tmp_path / "flight.bin"
    flight = made.flight([20 + 0.1 * row for row in range(100)])
    path.write_bytes(made.log(*flight, *rows))
    return read_log(path).vehicles[0]


def test_the_core_that_flies_at_each_time_gives_velocity_and_ratios(tmp_path, monkeypatch):
    """ArduPilot's estimator switches from core 0 to core 1 at 25 s."""
    rows = []
    for second in range(20, 30):
        primary = 1.0 * (second >= 25)
        for core in (0, 1):
            stamp = 1_000_000 * second
            rows.append(("XKF4", (stamp, core, 0.1 + core, 0.1, 0.1, 0.1, 831, primary)))
            rows.append(("XKF1", (stamp, core, 10.0 * core + second, 0, 0, 0, 0, 0)))
    vehicle = vehicle_with(tmp_path, estimates(monkeypatch, rows))
    velocity = vehicle.messages["LOCAL_POSITION_NED"]["vx"]
    assert_allclose(velocity, [20, 21, 22, 23, 24, 35, 36, 37, 38, 39])
    ratios = vehicle.messages["EKF_STATUS_REPORT"]["velocity_variance"]
    assert_allclose(ratios, [0.1] * 5 + [1.1] * 5, atol=1e-6)
    instances = vehicle.messages[INSTANCES_MESSAGE]
    assert instances["is_primary"].sum() == 10 and len(instances["time"]) == 20
    assert not [fact for fact in vehicle.repairs if fact.code is Repair.OTHER_CORE_READ]


def test_another_core_stands_in_for_one_that_was_not_logged(tmp_path, monkeypatch):
    """The primary core 0 was not logged: core 1 is used, and that is reported."""
    rows = []
    for second in range(20, 30):
        stamp = 1_000_000 * second
        rows.append(("XKF4", (stamp, 1, 0.2, 0.1, 0.1, 0.1, 831, 0.0)))
        rows.append(("XKF1", (stamp, 1, second, 0, 0, 0, 0, 0)))
    vehicle = vehicle_with(tmp_path, estimates(monkeypatch, rows))
    assert_allclose(vehicle.messages["LOCAL_POSITION_NED"]["vx"], np.arange(20, 30))
    assert vehicle.name_in_source("LOCAL_POSITION_NED") == "XKF1[1]"
    (repair,) = [fact for fact in vehicle.repairs if fact.code is Repair.OTHER_CORE_READ]
    assert repair.figures["names"] == ("XKF1[1]", "XKF4[1]")


def test_cores_of_old_versions_have_messages_of_their_own(tmp_path, monkeypatch):
    old_motion = MOTION.replace("C,", "")
    rows = []
    for second in range(20, 30):
        stamp = 1_000_000 * second
        rows.append(("XKF6", (stamp, second, 0, 0, 0, 0, 0)))
        rows.append(("XKF9", (stamp, 0.2, 0.1, 0.1, 0.1, 831, 1.0)))
    fields = (old_motion, STATUS.replace("C,", ""))
    vehicle = vehicle_with(tmp_path, estimates(monkeypatch, rows, ("XKF6", "XKF9"), fields))
    assert_allclose(vehicle.messages["LOCAL_POSITION_NED"]["vx"], np.arange(20, 30))
    assert vehicle.name_in_source("LOCAL_POSITION_NED") == "XKF1"


def test_the_path_of_pos_stands_in_for_a_filter_that_was_not_logged(tmp_path, monkeypatch):
    definition = (162, "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt")
    monkeypatch.setitem(made.MESSAGES, "POS", definition)
    rows = []
    for second in range(20, 30):
        degrees = (520_000_000 + 100 * second, 43_000_000)
        rows.append(made.message("POS", 1_000_000 * second, *degrees, 5.0, second - 20.0, 1.0))
    signals = Signals(vehicle_with(tmp_path, rows))
    assert_allclose(signals.height.values, np.arange(10.0))
    assert_allclose(np.diff(signals.position.values[:, 0]), 1.11, atol=0.01)


def topic(**fields):
    count = 10
    columns_of_topic = {name: np.full(count, value) for name, value in fields.items()}
    return {"time": np.arange(count, dtype=float), **columns_of_topic}


def test_px4_s_primary_instance_gives_the_estimator_s_status():
    """Of two instances PX4's selector names number 1; without the selector there is one."""
    ratios = {"hgt_test_ratio": 0.1, "mag_test_ratio": 0.1, "solution_status_flags": 831}
    topics = {
        "estimator_status": {
            0: topic(vel_test_ratio=0.1, pos_test_ratio=0.1, **ratios),
            1: topic(vel_test_ratio=0.2, pos_test_ratio=1.8, **ratios),
        },
        "estimator_selector_status": {0: topic(primary_instance=1)},
    }
    assert_allclose(estimator_status(topics)["pos_horiz_ratio"], 1.8)
    instances = estimator_instances(topics)
    assert_array_equal(instances["is_primary"], instances["instance"])
    del topics["estimator_selector_status"], topics["estimator_status"][1]
    assert_allclose(estimator_status(topics)["pos_horiz_ratio"], 0.1)
    assert not estimator_instances(topics)


def aided(**aid_topics):
    """Topics of an estimator whose filtered velocity ratio stays at 0.9, with samples of aiding sources."""
    ratios = {"pos_test_ratio": 0.1, "hgt_test_ratio": 0.1, "mag_test_ratio": 0.1}
    status = topic(vel_test_ratio=0.9, solution_status_flags=831, **ratios)
    return {"estimator_status": {0: status}} | {
        f"estimator_aid_src_{name}": {1: columns} for name, columns in aid_topics.items()
    }


def aid(squares, fused):
    count = len(squares)
    return {
        "time": np.arange(count) / 2,
        "estimator_instance": np.zeros(count, int),
        "test_ratio[0]": np.full(count, 0.01),
        "test_ratio[1]": np.array(squares),
        "fused": np.array(fused),
    }


def test_a_rejected_sample_of_an_aiding_source_shows_beside_a_filtered_ratio():
    velocity = aid([0.04, 0.04, 0.04, 1.44, 0.04, 0.04], fused=[1, 1, 1, 0, 1, 1])
    status = estimator_status(aided(gnss_vel=velocity))
    # The samples end at 2.5 s: later, the filtered ratio is all there is.
    assert_allclose(status["vel_ratio"], [0.2, 0.2, 1.2, 0.2] + [0.9] * 6)
    assert_array_equal(status["vel_ratio_is_unfiltered"], [1, 1, 1, 1] + [0] * 6)
    assert "hgt_ratio_is_unfiltered" not in status


def test_an_aiding_source_that_the_estimator_never_fused_does_not_count():
    status = estimator_status(aided(ev_vel=aid([9.0] * 6, fused=[0] * 6)))
    assert_allclose(status["vel_ratio"], 0.9)


@pytest.mark.parametrize(
    ("first_rejected", "ratios"),
    [
        (None, [0.2, 0.2, 0.2, 0.9, 0.9]),
        # PX4 goes on to compare a deselected source, and calls it rejected.
        (4, [0.2, 0.2, 0.2, 0.9, 0.9]),
        (3, [0.2, 0.2, 5.0, 5.0, 5.0]),
    ],
)
def test_an_aiding_source_that_is_not_used_any_more_does_not_count(first_rejected, ratios):
    """GPS velocity is fused in the first three samples only. Its test ratio is the root of the ratio in the log."""
    rejected = np.zeros(12, int)
    if first_rejected is not None:
        rejected[first_rejected:] = 1
    squares, fused = [0.04] * 3 + [25.0] * 9, [1] * 3 + [0] * 9
    velocity = {**aid(squares, fused), "innovation_rejected": rejected}
    status = estimator_status(aided(gnss_vel=velocity))
    assert_allclose(status["vel_ratio"][:5], ratios)


@pytest.mark.parametrize(
    ("firmware", "is_sampled", "is_filtered"),
    [("PX4 v1.15.0", 0, True), ("PX4 v1.15.0", 1, False), ("PX4 v1.12.3", 0, False)],
)
def test_filtered_ratios_are_called_filtered(firmware, is_sampled, is_filtered):
    """PX4 from 1.14 logs test ratios that are low-pass filtered, unless single samples are logged."""
    ratios = dict.fromkeys(("pos_horiz_ratio", "pos_vert_ratio", "mag_ratio"), 0.1 + 0 * TIME)
    telemetry = HOVER.telemetry(20.0, 20.0)
    messages = dict(telemetry.messages)
    messages.pop("EKF_STATUS_REPORT", None)
    telemetry = replace(telemetry, messages=messages, autopilot="PX4", firmware=firmware)
    status = columns(
        TIME,
        vel_ratio=0.9 + 0 * TIME,
        vel_ratio_is_unfiltered=np.full(len(TIME), is_sampled),
        **ratios,
    )
    fact = estimator_light(evidence(changed(telemetry, "ESTIMATOR_STATUS", **status)))
    assert fact.level == "good" and ("filtered" in str(fact)) is is_filtered
