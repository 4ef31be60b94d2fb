"""The rate loop by system identification: of a known plant in wind, and of a recorded flight with a chirped truth."""

import numpy as np
from hover import columns
from known_gains import ARDUPILOT
from numpy.random import default_rng
from pytest import approx, mark
from recorded_flights import recorded

from mavdem.alignment.align import recorded_parts
from mavdem.alignment.signals import Signals
from mavdem.assessment.axis_margins import AxisMargins
from mavdem.condition.injected import injected_loop
from mavdem.condition.loop.controllers import controller_of
from mavdem.condition.loop.margins import OpenLoop, transfer
from mavdem.facts import Level
from mavdem.facts.margins import MarginsLight
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import Injection

CYCLE = 1 / 400
EFFECT, DAMPING, LATE = (
    350.0,
    2.0,
    3,
)  # rad/s² per demand, 1/s, cycles from the command to its torque
GAINS = ARDUPILOT | {"ATC_RAT_RLL_P": 0.1, "ATC_RAT_RLL_I": 0.0, "ATC_RAT_RLL_D": 0.001}


def flown(where):
    """A rate loop of known gains, seconds 0 to 60, with a chirp from 1 to 30 Hz, in wind and with gyro noise."""
    time = CYCLE * np.arange(24000)
    chirp = np.sin(2 * np.pi * (time + 29 * time**2 / 120))
    chirp *= 0.05 if where is Injection.DEMAND else 0.5
    torque, noise = default_rng(5).normal(size=(2, len(time)))
    frequency = np.fft.rfftfreq(len(time), CYCLE).clip(1e-6)
    plant, back = responses(frequency)
    late = np.exp(-2j * np.pi * frequency * CYCLE)
    wind = plant / EFFECT / late**LATE / (1 - 0.99 * late) * np.fft.rfft(torque)
    noise = 0.005 * np.fft.rfft(noise)
    injected = (back if where is Injection.RATE_SETPOINT else 1.0) * np.fft.rfft(chirp)
    asked = (injected - back * (wind + noise)) / (1 + back * plant)
    demand, rate = (np.fft.irfft(one) for one in (asked, plant * asked + wind + noise))
    controls = np.pad(demand[:, None], ((0, 0), (0, 7)))
    still = dict.fromkeys(("roll", "pitch", "yaw", "pitchspeed", "yawspeed"), 0 * time)
    scaled = chirp if where is Injection.DEMAND else np.degrees(chirp)
    messages = {
        "SIDD": columns(time, axis=int(where), target=scaled),
        "ACTUATOR_CONTROL_TARGET": columns(time, group_mlx=0.0, controls=controls),
        "ATTITUDE": columns(time, **still, rollspeed=rate),
        "ATTITUDE_TARGET": columns(time, type_mask=128, body_roll_rate=0.0),
    }
    messages["ATTITUDE_TARGET"]["q"] = np.full((len(time), 4), np.nan)
    return Signals(Telemetry(1, 1, "QUADROTOR", "ARDUPILOTMEGA", messages, GAINS))


def responses(frequency):
    """Of the rate by the demand, and of the controller."""
    late = np.exp(-2j * np.pi * frequency * CYCLE)
    plant = EFFECT * CYCLE * late ** (LATE + 1) / (1 - (1 - DAMPING * CYCLE) * late)
    return plant, transfer(controller_of(GAINS, "roll", (1.0,)), frequency)[1]


@mark.parametrize("where", [Injection.DEMAND, Injection.RATE_SETPOINT])
def test_the_loop_is_the_known_one_whatever_the_wind(where):
    signals = flown(where)
    found = injected_loop(signals, recorded_parts(signals))
    frequency = np.linspace(1, 30, 600)
    plant, back = responses(frequency)
    expected = OpenLoop(frequency, (back * plant)[None], back[None], back[None])
    assert found.crossover == approx(expected.crossover, rel=0.05)
    assert found.phase_margin == approx(expected.phase_margin, abs=3)
    assert found.ms == approx(expected.ms, rel=0.1)


def test_the_recorded_flight_has_its_chirped_margins():
    """Of ArduCopter's simulator, by a chirp at the mixer: 20.1 Hz, 19°, 2.8 dB, Ms 4.9. The sweep of roll was cut."""
    signals = Signals(recorded("sitl_raw/ap_sid.BIN.xz"), axis="pitch")
    found = injected_loop(signals, recorded_parts(signals))
    assert found.crossover == approx(20.1, abs=0.3)
    assert found.phase_margin == approx(19, abs=1.5)
    assert found.gain_margin == approx(2.8, abs=1)
    assert found.ms == approx(4.9, rel=0.1)
    assert injected_loop(signals.about("roll"), recorded_parts(signals)) is None


@mark.parametrize("gain, level", [(12.0, Level.GOOD), (20.0, Level.WATCH), (24.0, Level.BAD)])
def test_its_light_is_by_the_usual_and_the_least_margins(gain, level):
    frequency = np.geomspace(1, 40, 500)
    s = 2j * np.pi * frequency
    loop = (gain * np.exp(-0.04 * s) / s)[None]
    (fact,) = AxisMargins("roll", None, None, None, OpenLoop(frequency, loop, loop, loop)).facts
    assert (fact.code, fact.level) == (MarginsLight.LOOP_MEASURED, level)
    assert fact.figures["phase_margin"] == approx(90 - np.degrees(gain * 0.04), abs=0.2)
