"""A live session with a vehicle that ArduPilot's habits and faults befall: what comes of it, on a clock of its own."""

import numpy as np
import pytest
from live_faults import error_ratios, run_session, undisturbed

import mavdem
from sitl_scenarios.files import load, scenario_of

SHORT = {"duration": 40.0, "flights": 2, "height": 5.0}
FAULTS = {"reboot": 14.0, "outage": 25.0, "outage_seconds": 4.0, "clock_jump": 32.0, "mavproxy_rate": 4.0}


@pytest.mark.slow
@pytest.mark.usefixtures("without_wind_fits")
def test_a_session_with_all_faults_ends_with_a_good_model_and_every_second_is_accounted_for(monkeypatch):
    monkeypatch.setattr("live_faults.RATE", 50.0)
    long = load("ardupilot_faults").model_dump(mode="json")
    weak = {**long["vehicle"], "weak_from": 43.0}  # all of the second flight
    scenario = scenario_of({**long, **SHORT, "faults": FAULTS, "vehicle": weak})
    session, account = run_session(scenario)
    said = " ".join(event.sentence for event in session.history.events)
    for each in ("rebooted", "again after", "is on the ground", "of the vehicle's clock", "set back again and again"):
        assert each in said
    assert "assumed" not in said, "parameters say where the motors are, and come when they are asked for"
    assert sum(account.values()) == pytest.approx(86.0, abs=0.5)
    # Learned from is the time that the samples span, 1661 of 0.02 s, not that in which some came.
    assert account["learned"] == pytest.approx(session.status.learned / 50.0) and account["learned"] > 33.0, account
    assert account["silent"] > 2.5 and account["waiting"] < 25.0, account
    kept = session.final_model()
    test, train = (undisturbed(scenario, seed, weak=True) for seed in (1001, 1002))
    ratios, offline = error_ratios(kept, test), error_ratios(mavdem.learn(train), test)
    # Of the samples that are kept, a fifth are of the first flight, whose motors were sound.
    assert np.all(ratios < 2 * offline) and ratios[0] < 0.1, (ratios, offline)
