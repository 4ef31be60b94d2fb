"""The part of a session's recording by which its latest flight is judged."""

from dataclasses import dataclass, replace

import numpy as np
from hover import X_QUAD_PARAMETERS, Hover, columns
from pytest import mark, param

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.assessment.flights import flights_in_boot
from mavdem.assessment.status_texts import status_texts
from mavdem.dataset.signals import Signals
from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.ingest.telemetry import concatenated_columns, log_of_vehicles, selected_rows
from mavdem.live.latest_flight import log_of_latest_flight

SECONDS_BETWEEN_TAKE_OFFS = 80.0


@dataclass(frozen=True)
class HoverWithMotor(Hover):
    """A short hover in which one motor, if any, works harder."""

    motor: int | None = None
    level: float = 8.0
    hovering: float = 22.0

    def motors(self, t):
        pulse_widths = super().motors(t)
        if self.motor is not None:
            pulse_widths[(t > self.level) & (t < self.landed), self.motor] += 150.0
        return pulse_widths


def log_of_boot(*weak_motors):
    """Returns a log of one boot with a flight for each of these motors, which works harder in it; None for no motor."""
    flights = []
    for number, motor in enumerate(weak_motors):
        telemetry = HoverWithMotor(motor=motor).telemetry(
            attitude_time=50.0, motor_time=50.0, parameters=X_QUAD_PARAMETERS
        )
        offset = number * SECONDS_BETWEEN_TAKE_OFFS
        flights.append(
            {
                name: {**table, "time": table["time"] + offset}
                for name, table in telemetry.messages.items()
            }
        )
    messages = {
        name: concatenated_columns([flight[name] for flight in flights]) for name in flights[0]
    }
    return log_of_vehicles((replace(telemetry, messages=messages),), 0, 0)


def lights_of(log):
    """Returns the lights of the only vehicle of a log."""
    return assess(log, axis="roll", options=Options(with_model=False)).lights


@mark.slow
@mark.parametrize(
    "first_weak_motor, second_weak_motor", [(2, None), param(None, 2, marks=mark.in_full)]
)
def test_of_two_flights_of_a_boot_the_second_is_judged_as_if_it_were_alone(
    first_weak_motor, second_weak_motor
):
    lights = lights_of(log_of_latest_flight(log_of_boot(first_weak_motor, second_weak_motor)))
    lights_of_second = lights_of(log_of_boot(second_weak_motor))
    assert lights[Light.MOTORS] == lights_of_second[Light.MOTORS]
    assert (lights[Light.MOTORS].level is Level.GOOD) == (second_weak_motor is None)
    for light, fact in lights.items():
        assert (fact.code, fact.level) == (
            lights_of_second[light].code,
            lights_of_second[light].level,
        )


def test_what_was_stated_once_for_a_boot_is_kept_of_its_latest_flight():
    """Parameters and the names of firmware and board come at boot, and what is reported of a flight is of it alone."""
    log = log_of_boot(None, None)
    [telemetry] = log.vehicles
    [(_, first_landing), (second_take_off, _)] = flights_in_boot(Signals(telemetry), 0)
    parameters = columns(
        np.array([1.0, first_landing - 5.0]),
        param_id=np.array([b"ATC_RAT_RLL_P", b"ATC_RAT_RLL_P"]),
        param_type=9,
        param_value=np.array([0.1, 0.2]),
    )
    texts = columns(
        np.array([1.0, 2.0, first_landing - 5.0, second_take_off + 5.0]),
        severity=np.array([6, 2, 6, 6]),
        text=np.array(
            [b"ArduCopter V4.5.7", b"PreArm: Compass", b"AutoTune: Success", b"Mission: 1"]
        ),
    )
    messages = {**telemetry.messages, "PARAM_VALUE": parameters, "STATUSTEXT": texts}
    log = log_of_vehicles((replace(telemetry, messages=messages),), 0, 0)
    [latest] = log_of_latest_flight(log).vehicles
    assert [text.text for text in status_texts(latest)] == ["ArduCopter V4.5.7", "Mission: 1"]
    assert latest.messages["PARAM_VALUE"]["param_value"].tolist() == [0.1, 0.2]
    start = latest.messages["ATTITUDE"]["time"][0]
    assert first_landing < start < second_take_off
    assert (latest.messages["PARAM_VALUE"]["time"] >= first_landing).all()
    assert flights_in_boot(Signals(latest), 0) == flights_in_boot(Signals(telemetry), 0)[1:]


def test_only_the_last_boot_that_flew_is_judged():
    """The clock of another boot says other seconds, and two vehicles may have had the ids one after the other."""
    flown = Hover(hovering=8.0).telemetry(attitude_time=20.0, motor_time=20.0)
    boots = []
    for boot, end_time in enumerate((40.0, 40.0, 4.0)):
        messages_of_boot = {}
        for name, table in flown.messages.items():
            rows = np.flatnonzero(table["time"] < end_time)
            messages_of_boot[name] = selected_rows(table, rows) | {"boot": np.full(len(rows), boot)}
        boots.append(messages_of_boot)
    messages = {
        name: concatenated_columns([messages_of_boot[name] for messages_of_boot in boots])
        for name in flown.messages
    }
    log = log_of_vehicles((replace(flown, messages=messages),), 0, 0)
    [last] = log_of_latest_flight(log).vehicles
    for name, table in last.messages.items():
        assert (table["time"] == boots[1][name]["time"]).all()
        assert not table["boot"].any()
    single = log_of_vehicles((flown,), 0, 0)
    assert log_of_latest_flight(single).vehicles[0] is flown
    silent = replace(flown, messages={})
    assert log_of_latest_flight(log_of_vehicles((silent,), 0, 0)).vehicles[0] is silent


def test_the_last_boot_of_another_autopilot_has_its_parameters():
    columns = {
        "param_id": np.array([b"FRAME_CLASS", b"MC_ROLL_P"]),
        "param_type": np.array([9, 9]),
        "param_value": np.array([1.0, 6.5], "<f4"),
    }
    flown = Hover(hovering=8.0).telemetry(attitude_time=20.0, motor_time=20.0)
    messages = {}
    for name, table in flown.messages.items():
        boots = np.repeat([0, 1], len(table["time"]))
        messages[name] = concatenated_columns([table, table]) | {"boot": boots}
    messages["PARAM_VALUE"] = columns | {"time": np.zeros(2), "boot": np.array([0, 1])}
    autopilots = {"autopilot": np.where(messages["HEARTBEAT"]["boot"] == 0, 3, 12)}
    messages["HEARTBEAT"] = messages["HEARTBEAT"] | autopilots
    log = log_of_vehicles((replace(flown, messages=messages),), 0, 0)
    [last] = log_of_latest_flight(log).vehicles
    assert (last.autopilot, dict(last.parameters)) == ("PX4", {"MC_ROLL_P": 6.5})
