"""Spectra of made-up noise, the names of its lines, and the notch filters for them."""

from dataclasses import replace

import numpy as np
from hover import X_QUAD_PARAMETERS, Hover, changed, columns, with_pulses
from numpy.random import default_rng
from pytest import approx, mark
from recorded_flights import recorded

from mavdem.alignment.align import Segment
from mavdem.alignment.signals import Signals
from mavdem.assessment.noise import Noise
from mavdem.condition.loop.controllers import controller_of
from mavdem.condition.loop.filters import gyro_filters
from mavdem.condition.notches import notch_advice
from mavdem.condition.peaks import PeakKind, peaks_of
from mavdem.condition.spectra import Spectrum, spectra_of_flight, thinned
from mavdem.facts.noise import Noise as Codes
from mavdem.facts.noise import NotchAdvice

HOVER = Hover(hovering=40.0)
FLOWN = (Segment(0, 8.0, 45.0),)
CONTROL = {
    f"ATC_RAT_RLL_{name}": value
    for name, value in {
        "P": 0.1,
        "I": 0.1,
        "D": 0.003,
        "FLTT": 20.0,
        "FLTE": 0.0,
        "FLTD": 20.0,
    }.items()
} | {"ATC_ANG_RLL_P": 4.5, "MOT_THST_EXPO": 0.65, "INS_GYRO_FILTER": 80.0, "MOT_THST_HOVER": 0.35}


def throttle(time):
    """A share of the motors' range that climbs and sinks."""
    return 0.5 + 0.12 * np.sin(2 * np.pi * time / 11.0)


def shaken(rate=1000.0, speed=0.0, frame=0.0, steady=0.0):
    """A hover with gyro samples at a ``rate``: noise, and lines of motors, Hz at half throttle, and of the frame."""
    draw = default_rng(7)
    time = HOVER.stamps(rate)
    share = throttle(time)
    phase = 2 * np.pi * np.cumsum(speed * np.sqrt(share / 0.5)) / rate
    values = 1e-3 * draw.standard_normal((3, len(time)))
    if speed:
        values += 0.02 * np.sin(phase) + 0.01 * np.sin(2 * phase)
    if frame:
        values += 0.01 * np.sin(2 * np.pi * frame * time)
    telemetry = HOVER.telemetry(100.0, 100.0, parameters=X_QUAD_PARAMETERS)
    stamps = telemetry.messages["SERVO_OUTPUT_RAW"]["time"]
    level = throttle(stamps) if not steady else np.full(len(stamps), steady)
    telemetry = with_pulses(telemetry, np.tile(1000 + 1000 * level, (4, 1)))
    return changed(
        telemetry, "GYRO_BEFORE", **columns(time, **dict(zip("xyz", values, strict=True)))
    )


def lines(telemetry):
    found = spectra_of_flight(Signals(telemetry), FLOWN)
    return found, peaks_of(found["gyro_before"])


def noise(telemetry, notch=None):
    found = spectra_of_flight(Signals(telemetry), FLOWN)
    return Noise(found, {name: peaks_of(one) for name, one in found.items()}, notch)


def codes(facts):
    return [fact.code for fact in facts]


def test_density_has_the_power_of_what_was_measured():
    found, _ = lines(shaken(frame=80.0))
    spectrum = found["gyro_before"]
    assert spectrum.highest == approx(500.0) and spectrum.source == "GYRO_BEFORE"
    assert spectrum.power(75, 85) == approx(3 * 0.01**2 / 2, rel=0.05)
    assert spectrum.power(200, 400) == approx(3 * 1e-6 * 0.4, rel=0.1)
    levels, by_throttle = spectrum.by_throttle
    assert levels[0] == approx(0.38, abs=0.02) and levels[-1] == approx(0.62, abs=0.02)
    assert by_throttle.shape == (12, len(spectrum.frequency))


def test_the_d_term_has_a_spectrum():
    telemetry = shaken(frame=80.0)
    samples = telemetry.messages["GYRO_BEFORE"]
    found = spectra_of_flight(Signals(changed(telemetry, "D_TERM", **samples)), FLOWN)
    assert found["d_term"].power(75, 85) == approx(found["gyro_before"].power(75, 85))
    assert found["d_term"].unit == "1"


def test_stamps_that_hardly_differ_have_no_spectrum():
    telemetry = shaken()
    time = np.linspace(8.0, 9.0, len(telemetry.messages["GYRO_BEFORE"]["time"])) * 1e-308
    signals = Signals(changed(telemetry, "GYRO_BEFORE", time=time))
    assert "gyro_before" not in spectra_of_flight(signals, FLOWN)


def test_nothing_by_throttle_is_thinned_to_nothing():
    frequency, density = thinned(np.arange(6.0), np.zeros((0, 6)), 3)
    assert list(frequency) == [0.5, 2.5, 4.5] and density.shape == (0, 3)


def lined(*lines, wide=1.0, highest=500.0):
    """The lines of made-up windows at throttles of 42 to 58 %, by Hz, power over the noise, and exponent."""
    frequency = np.arange(highest + 1)
    level = np.linspace(0.42, 0.58, 41)
    density = np.ones((41, len(frequency)))
    for hertz, power, exponent in lines:
        off = frequency - hertz * (level[:, None] / 0.5) ** exponent
        density += power * np.exp(-((off / wide) ** 2) / 2)
    density = density[:, None]
    return peaks_of(Spectrum("gyro", "1", "", frequency, level, density, level, level * np.nan))


KINDS = {
    PeakKind.ALIAS: (-0.6, -0.5),
    PeakKind.UNNAMED: (-0.4, -0.3, 0.3, 2.1),
    PeakKind.FRAME: (-0.2, 0.2),
    PeakKind.MOTOR: (0.4, 2.0),
}


@mark.parametrize("kind", KINDS)
def test_how_a_line_moves_with_the_throttle_names_it(kind):
    for exponent in KINDS[kind]:
        (line,) = lined((100.3, 1000.0, exponent), wide=3.0)
        assert line.kind is kind and (line.frequency, line.width) == approx((100.3, 14), abs=0.03)
        assert line.exponent == (None if kind is PeakKind.UNNAMED else exponent)
    # Of slow samples it may be a harmonic's alias.
    steep = [lined((60.0, 1000.0, 1.3), wide=3.0, highest=one)[0] for one in (249.0, 250.0)]
    assert [line.kind for line in steep] == [PeakKind.UNNAMED, PeakKind.MOTOR]


def test_the_eight_strongest_lines_over_six_times_the_noise_are_kept_that_are_8_percent_apart():
    hertz = [17, 35, 45, 100, 109, 200, 214, 420, 280, 470, 330]
    powers = [90, 80, 70, 60, 50, 40, 39, 30, 5.7, 5.4, 4.5]
    found = lined(*zip(hertz, powers, np.zeros(11), strict=True))
    assert [round(line.frequency) for line in found] == [17, 100, 109, 200, 35, 420, 45, 280]
    slow = [line.frequency < 40 for line in found]
    assert slow == [line.kind is PeakKind.UNNAMED for line in found]


def test_multiples_of_a_motors_line_up_to_six_to_2_percent_are_its_harmonics():
    multiples = {1: 1000.0, 2: 500.0, 3.066: 300.0, 6: 200.0, 7: 100.0}
    moving = [(50.0 * many, power, 0.5) for many, power in multiples.items()]
    # Weaker than a hundredth of it, what has no name is of it.
    found = lined(*moving, (25.0, 14.5, 0.0), (34.0, 9.0, 0.0))
    assert [line.harmonics for line in found] == [(1, 2, 6), (1,), (1,), (1,)]
    assert [line.frequency for line in found] == approx([50.0, 153.3, 350.0, 25.0], rel=2e-3)


def test_motors_and_frame_are_told_apart_by_the_throttle():
    telemetry = shaken(speed=140.0, frame=90.0)
    _, found = lines(telemetry)
    motors, frame = sorted(found, key=lambda one: -one.frequency)
    assert motors.kind is PeakKind.MOTOR and motors.harmonics == (1, 2)
    assert motors.frequency == approx(140.0, rel=0.02) and motors.exponent == approx(0.5, abs=0.15)
    assert frame.kind is PeakKind.FRAME and frame.frequency == approx(90.0, rel=0.02)
    said = codes(noise(telemetry).facts)
    assert said[0] is Codes.SPECTRUM_SEEN and {Codes.MOTOR_LINE, Codes.FRAME_LINE} <= {*said}


def test_what_does_not_move_has_no_name_and_what_folds_is_an_alias():
    still = noise(shaken(frame=90.0, steady=0.5))
    assert codes(still.facts) == [Codes.SPECTRUM_SEEN, Codes.UNNAMED_LINE]
    # 140 Hz, sampled at 200, is at 60 and falls as the throttle rises.
    folded = noise(shaken(200.0, speed=140.0))
    (alias, *_) = folded.lines
    assert alias.kind is PeakKind.ALIAS and alias.frequency == approx(60.0, rel=0.02)
    assert Codes.ALIASED_LINE in codes(folded.facts)
    assert codes(Noise({}, {}).facts) == [Codes.NO_SPECTRUM]


def test_motors_speeds_that_are_logged_name_their_order():
    telemetry = shaken(speed=140.0, steady=0.5)
    time = HOVER.stamps(10.0)
    turns = 70.0 * np.sqrt(throttle(time) / 0.5)
    _, found = lines(changed(telemetry, "ESC", **columns(time, RPM=60 * turns)))
    assert found[0].kind is PeakKind.MOTOR and found[0].exponent == approx(1.0, abs=0.15)
    assert found[0].order == approx(2.0, rel=0.02)


def advice(telemetry, crossover=12.0, **parameters):
    found, peaks = lines(telemetry)
    controller = controller_of(CONTROL | parameters, "roll", (1.0,))
    before = found["gyro_before"]
    return notch_advice(controller, peaks, before, found.get("gyro"), crossover), controller


def test_a_notch_takes_the_line_and_says_its_cost():
    telemetry = shaken(speed=140.0)
    fact, controller = advice(telemetry)
    assert fact.code is NotchAdvice.SET_NOTCH and fact.figures["share"] > 0.9
    settings = dict(fact.figures["settings"])
    assert settings["INS_HNTCH_FREQ"] == approx(140.0, rel=0.02)
    assert settings["INS_HNTCH_HMNCS"] == 3.0 and settings["INS_HNTCH_REF"] == 0.35
    kinds = [settings[f"INS_HNTCH_{name}"] for name in ("ENABLE", "MODE", "ATT")]
    assert kinds == [1.0, 1.0, 40.0]
    lags = [gyro_filters(one, 12.0).phase_lag for one in (controller.changed(settings), controller)]
    assert fact.figures["phase_cost"] == approx(lags[0] - lags[1]) and 1 < lags[0] - lags[1] < 10
    set_already, _ = advice(telemetry, **settings)
    assert set_already.code is NotchAdvice.NOTCH_IN_PLACE
    assert noise(telemetry, fact).facts[-1] is fact
    elsewhere, _ = advice(
        telemetry, **{**settings, "INS_HNTCH_FREQ": 280.0, "INS_HNTCH_HMNCS": 1.0}
    )
    assert elsewhere.code is NotchAdvice.SET_NOTCH
    without, _ = advice(telemetry, crossover=None)
    assert without.figures["phase_cost"] is None


def test_a_notch_is_not_advised_where_there_is_nothing_to_take():
    none, _ = advice(shaken())
    assert none.code is NotchAdvice.NO_LINE_TO_REMOVE
    slow, _ = advice(shaken(speed=380.0), INS_GYRO_FILTER=10.0)
    assert slow.code is NotchAdvice.NOTCH_NOT_NEEDED


@mark.parametrize("name", ["off", "on"])
def test_the_motors_of_a_flight_with_batches_are_found_before_and_behind_the_notch(name):
    telemetry = recorded(f"sitl_raw/ap_raw_{name}.BIN.xz")
    found = spectra_of_flight(Signals(telemetry), (Segment(0, 58.0, 165.0),))
    (motors, *_) = peaks_of(found["gyro_before"])
    assert motors.kind is PeakKind.MOTOR and motors.harmonics == (1, 2)
    assert motors.frequency == approx(139.0, rel=0.02)
    assert found["gyro"].power(120, 200) == approx({"off": 3.6e-6, "on": 1.9e-7}[name], rel=0.1)
    both = Noise(found, {one: peaks_of(found[one]) for one in found})
    (removed,) = (fact for fact in both.facts if fact.code is Codes.FILTERS_REMOVE)
    behind, before = (found[name].power(104, 188) for name in ("gyro", "gyro_before"))
    assert 1 - removed.figures["share"] == approx(behind / before, rel=0.1)
    without = replace(telemetry, messages={**telemetry.messages, "GYRO_BEFORE": {}})
    del without.messages["GYRO_BEFORE"]
    assert "gyro_before" not in spectra_of_flight(Signals(without), (Segment(0, 58.0, 165.0),))
