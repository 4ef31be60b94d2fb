"""Spectra of made-up noise, the names of its lines, and the notch filters for them."""

from dataclasses import replace

import numpy as np
from hover import X_QUAD_PARAMETERS, Hover, changed, columns, with_pulses
from known_gains import ARDUPILOT
from numpy.random import default_rng
from pytest import approx, mark
from scipy.signal import find_peaks

from mavdem.assessment.noise_spectra import (
    MeasuredNoise,
    lines_with_oscillation,
    notch_for_firmware,
)
from mavdem.dataset.segments import Segment
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.noise import NoiseFact, NotchAdvice
from mavdem.loops.controllers import controller_from_parameters
from mavdem.loops.filters import gyro_filters
from mavdem.loops.limit_cycles import Oscillation
from mavdem.vibration.notch_filters import notch_advice
from mavdem.vibration.spectra import Spectrum, max_decimated, vibration_spectra
from mavdem.vibration.spectral_lines import (
    LineCause,
    SpectralLine,
    find_spectral_lines,
    prominent_peaks,
)

HOVER = Hover(hovering=40.0)
FLOWN = (Segment(0, 8.0, 45.0),)
CONTROL = ARDUPILOT | {"INS_GYRO_FILTER": 80.0, "MOT_THST_HOVER": 0.35}


def throttle(time):
    """A share of the motors' range that climbs and sinks."""
    return 0.5 + 0.12 * np.sin(2 * np.pi * time / 11.0)


def shaken(speed=0.0, frame=0.0, steady=0.0):
    """A hover with gyro samples at 1 kHz: noise, and lines of motors, Hz at half throttle, and of the frame."""
    time = HOVER.stamps(1000.0)
    phase = 2 * np.pi * np.cumsum(speed * np.sqrt(throttle(time) / 0.5)) / 1000
    values = default_rng(7).normal(0, 1e-3, (3, len(time)))
    values += 0.02 * np.sin(phase) + 0.01 * np.sin(2 * phase)
    values += 0.01 * np.sin(2 * np.pi * frame * time)
    telemetry = HOVER.telemetry(100.0, 100.0, parameters=X_QUAD_PARAMETERS)
    stamps = telemetry.messages["SERVO_OUTPUT_RAW"]["time"]
    level = steady or throttle(stamps)
    telemetry = with_pulses(telemetry, 4 * [1000 + 1000 * level])
    x, y, z = values
    return changed(telemetry, "GYRO_BEFORE", **columns(time, x=x, y=y, z=z))


def lines(telemetry):
    spectra = vibration_spectra(Signals(telemetry), FLOWN)
    return spectra, find_spectral_lines(spectra["gyro_before"])


@mark.slow
def test_density_has_the_power_of_what_was_measured():
    """A made-up gyro has a line at 80 Hz of amplitude 0.01 rad/s on three axes, and white noise."""
    telemetry = shaken(frame=80.0)
    samples = telemetry.messages["GYRO_BEFORE"]
    spectra, _ = lines(changed(telemetry, "D_TERM", **samples))
    spectrum = spectra["gyro_before"]
    assert spectrum.nyquist_frequency == approx(500.0) and spectrum.source == "GYRO_BEFORE"
    assert spectrum.mean_power(75, 85) == approx(3 * 0.01**2 / 2, rel=0.05)
    assert spectrum.mean_power(200, 400) == approx(3 * 1e-6 * 0.4, rel=0.1)
    levels, by_throttle = spectrum.density_by_throttle
    assert levels[0] == approx(0.38, abs=0.02) and levels[-1] == approx(0.62, abs=0.02)
    assert by_throttle.shape == (12, len(spectrum.frequency))
    of_d = spectra["d_term"]
    assert of_d.unit == "1" and of_d.mean_power(75, 85) == approx(spectrum.mean_power(75, 85))


@mark.slow
def test_stamps_that_hardly_differ_have_no_spectrum():
    telemetry = shaken()
    time = np.linspace(8.0, 9.0, len(telemetry.messages["GYRO_BEFORE"]["time"])) * 1e-308
    signals = Signals(changed(telemetry, "GYRO_BEFORE", time=time))
    assert "gyro_before" not in vibration_spectra(signals, FLOWN)


def test_nothing_by_throttle_is_thinned_to_nothing():
    frequency, density = max_decimated(np.arange(6.0), np.zeros((0, 6)), 3)
    assert list(frequency) == [0.5, 2.5, 4.5] and density.shape == (0, 3)


def lined(*lines, wide=1.0, highest=500.0, spread=0.08):
    """Returns the noise of made-up windows at throttles around 50 %.

    A line has a frequency, Hz, a power relative to the rest, and the exponent with which its frequency follows the
    throttle.
    """
    frequency = np.arange(highest + 1)
    level = np.linspace(0.5 - spread, 0.5 + spread, 41)
    density = np.ones((41, len(frequency)))
    for hertz, power, exponent in lines:
        off = frequency - hertz * (level[:, None] / 0.5) ** exponent
        density += power * np.exp(-((off / wide) ** 2) / 2)
    noise = Spectrum("gyro", "1", "", frequency, level, density[:, None], level, level * np.nan)
    return MeasuredNoise({"gyro": noise}, {"gyro": find_spectral_lines(noise)})


@mark.slow
@mark.parametrize(
    "kind, code, exponents",
    [
        (LineCause.ALIAS, NoiseFact.ALIASED_LINE, (-0.6, -0.5)),
        (LineCause.UNNAMED, NoiseFact.UNNAMED_LINE, (-0.4, -0.3, 0.3, 2.1)),
        (LineCause.FRAME, NoiseFact.FRAME_LINE, (-0.2, 0.2)),
        (LineCause.MOTOR, NoiseFact.MOTOR_LINE, (0.4, 2.0)),
    ],
)
def test_how_a_line_moves_with_the_throttle_names_it(kind, code, exponents):
    """The exponent of a line's frequency by the throttle tells motors, frame, aliases, and unknown causes apart."""
    for exponent in exponents:
        noise = lined((100.3, 1000.0, exponent), wide=3.0)
        (line,) = noise.lines
        assert line.cause is kind and (line.frequency, line.width) == approx((100.3, 14), abs=0.03)
        assert line.exponent == (None if kind is LineCause.UNNAMED else exponent)
        assert [fact.code for fact in noise.facts] == [NoiseFact.SPECTRUM_SEEN, code]
    # Of slow samples it may be a harmonic's alias.
    slow, fast = (
        lined((60.0, 1000.0, 1.3), wide=3.0, highest=nyquist).lines for nyquist in (249.0, 250.0)
    )
    assert (slow[0].cause, fast[0].cause) == (LineCause.UNNAMED, LineCause.MOTOR)


@mark.parametrize("exponent", [0.0, 0.5, 1.0, -1.0, -2.0])
def test_a_sharp_line_is_found_however_it_moves_with_the_throttle(exponent):
    (line,) = lined((100.3, 20.0, exponent), spread=0.2).lines
    assert line.frequency == approx(100.3, abs=0.1)
    assert line.exponent == approx(exponent)


def test_no_line_is_reported_at_the_edge_of_a_spectrum_where_it_may_be_folded():
    (line,) = lined((180.0, 1000.0, 0.0), wide=3.0, highest=200.0).lines
    assert line.frequency == approx(180.0, abs=0.1)
    assert not lined((198.0, 1000.0, 0.0), wide=3.0, highest=200.0).lines


def test_a_steady_throttle_names_no_line_and_a_missing_spectrum_is_reported():
    (still,) = lined((100.3, 1000.0, 0.0), wide=3.0, spread=0.0).lines
    assert still.cause is LineCause.UNNAMED
    assert [fact.code for fact in MeasuredNoise({}, {}).facts] == [NoiseFact.NO_SPECTRUM]


@mark.slow
def test_the_eight_strongest_lines_above_the_noise_and_8_percent_apart_are_kept():
    hertz = [17, 35, 45, 100, 109, 200, 214, 420, 280, 470, 330]
    powers = [90, 80, 70, 60, 50, 40, 39, 30, 5.7, 5.4, 4.5]
    spectra = lined(*zip(hertz, powers, np.zeros(11), strict=True)).lines
    assert [round(line.frequency) for line in spectra] == [17, 100, 109, 200, 35, 420, 45, 280]
    slow = [line.frequency < 40 for line in spectra]
    assert slow == [line.cause is LineCause.UNNAMED for line in spectra]


@mark.slow
def test_multiples_of_a_motors_line_up_to_six_to_2_percent_are_its_harmonics():
    multiples = {1: 1000.0, 2: 500.0, 3.066: 300.0, 6: 200.0, 7: 100.0}
    moving = [(50.0 * many, power, 0.5) for many, power in multiples.items()]
    # Weaker than a hundredth of it, what has no name is of it.
    spectra = lined(*moving, (200.0, 400.0, 0.0), (25.0, 14.5, 0.0), (34.0, 9.0, 0.0)).lines
    assert [line.harmonics for line in spectra] == [(1, 2, 6), (1,), (1,), (1,), (1,)]
    hertz = [50.0, 200.0, 153.3, 350.0, 25.0]  # The second line is of the frame.
    assert [line.frequency for line in spectra] == approx(hertz, rel=2e-3)


@mark.slow
def test_motors_speeds_that_are_logged_name_their_order():
    telemetry = shaken(speed=140.0, steady=0.5)
    time = HOVER.stamps(10.0)
    turns = 70.0 * np.sqrt(throttle(time) / 0.5)
    timed = changed(telemetry, "ESC", **columns(time, Instance=0, RPM=60 * turns))
    _, spectra = lines(timed)
    assert spectra[0].cause is LineCause.MOTOR and spectra[0].exponent == approx(1.0, abs=0.15)
    assert spectra[0].order == approx(2.0, rel=0.02)
    settings = dict(advice(timed)[0].figures["settings"])
    by_speed = settings["INS_HNTCH_MODE"], settings["INS_HNTCH_REF"]
    assert by_speed == (3.0, 1.0), "ArduPilot follows the speed that the controllers report"


def advice(telemetry, crossover=12.0, **parameters):
    spectra, peaks = lines(telemetry)
    controller = controller_from_parameters(CONTROL | parameters, "roll", (1.0,))
    before = spectra["gyro_before"]
    return notch_advice(controller, peaks, before, spectra.get("gyro"), crossover), controller


@mark.slow
def test_a_notch_takes_the_line_and_says_its_cost():
    """The motors' line at 140 Hz is removed by the advised notch, which costs phase at the crossover of 12 Hz."""
    telemetry = shaken(speed=140.0)
    fact, controller = advice(telemetry)
    assert fact.code is NotchAdvice.SET_NOTCH and fact.figures["share"] > 0.9
    settings = dict(fact.figures["settings"])
    assert settings["INS_HNTCH_FREQ"] == approx(140.0, rel=0.02)
    others = {"ENABLE": 1.0, "MODE": 1.0, "ATT": 40.0, "HMNCS": 3.0, "REF": 0.35}
    assert {name: settings[f"INS_HNTCH_{name}"] for name in others} == others
    before, after = (
        gyro_filters(nyquist, 12.0).phase_lag
        for nyquist in (controller, controller.with_parameters(settings))
    )
    assert fact.figures["phase_cost"] == approx(after - before) and 1 < after - before < 10
    set_already, _ = advice(telemetry, **settings)
    assert set_already.code is NotchAdvice.NOTCH_IN_PLACE
    assert lined()._replace(notch=fact).facts[-1] is fact
    elsewhere, _ = advice(telemetry, **settings | {"INS_HNTCH_FREQ": 280.0, "INS_HNTCH_HMNCS": 1.0})
    assert elsewhere.code is NotchAdvice.SET_NOTCH
    without, _ = advice(telemetry, crossover=None)
    assert without.figures["phase_cost"] is None


@mark.slow
def test_a_notch_is_not_advised_where_there_is_nothing_to_take():
    none, _ = advice(shaken())
    assert none.code is NotchAdvice.NO_LINE_TO_REMOVE
    slow, _ = advice(shaken(speed=380.0), INS_GYRO_FILTER=10.0)
    assert slow.code is NotchAdvice.NOTCH_NOT_NEEDED


@mark.slow
@mark.parametrize(("stride", "nyquist"), [(20, 25.0), (5, 100.0)])
def test_a_spectrum_that_may_end_below_the_motors_is_no_reason_against_a_notch(stride, nyquist):
    telemetry = shaken()
    gyro = {name: values[::stride] for name, values in telemetry.messages["GYRO_BEFORE"].items()}
    fact, _ = advice(changed(telemetry, "GYRO_BEFORE", **gyro))
    assert fact.code is NotchAdvice.SPECTRUM_BELOW_MOTORS
    assert fact.figures["highest"] == approx(nyquist, rel=0.02)


@mark.slow
def test_a_spectrum_beyond_the_logged_speed_of_the_motors_shows_that_no_notch_is_needed():
    telemetry = shaken()
    gyro = {name: values[::5] for name, values in telemetry.messages["GYRO_BEFORE"].items()}
    telemetry = changed(telemetry, "GYRO_BEFORE", **gyro)
    time = HOVER.stamps(10.0)
    for rotor_frequency, expected in (
        (70.0, NotchAdvice.NO_LINE_TO_REMOVE),
        (130.0, NotchAdvice.SPECTRUM_BELOW_MOTORS),
    ):
        speed = np.full(len(time), 60 * rotor_frequency)
        fact, _ = advice(changed(telemetry, "ESC", **columns(time, Instance=0, RPM=speed)))
        assert fact.code is expected


@mark.parametrize("seed", range(5))
def test_prominent_peaks_are_those_of_scipy(seed):
    curve = default_rng(seed).standard_normal(200).cumsum()
    expected, _ = find_peaks(curve, prominence=1.5)
    assert prominent_peaks(curve, 1.5) == expected.tolist()


@mark.parametrize(
    ("autopilot", "firmware", "words"),
    [
        ("ARDUPILOTMEGA", "ArduCopter V3.3 (bd817897)", "has no notch filter"),
        (
            "ARDUPILOTMEGA",
            "ArduCopter V4.5.1 (bd817897)",
            "INS_LOG_BAT_MASK 1 and INS_LOG_BAT_OPT 4.",
        ),
        ("PX4", "PX4 v1.14.0", "SDLOG_PROFILE"),
    ],
)
def test_advice_on_a_notch_names_only_what_the_firmware_has(autopilot, firmware, words):
    telemetry = replace(HOVER.telemetry(), autopilot=autopilot, firmware=firmware)
    slow = Fact(NotchAdvice.SPECTRUM_BELOW_MOTORS, highest=50.0, rotor_frequency=None)
    advice_text = notch_for_firmware(slow, telemetry).sentence_and_remedy
    assert words in advice_text
    assert ("INS_LOG" in advice_text) + ("SDLOG" in advice_text) <= 1


@mark.parametrize(
    ("parameter", "words"),
    [
        ("INS_NOTCH_ENABLE", "has only a fixed notch filter (INS_NOTCH_ENABLE)"),
        ("INS_HNTCH_ENABLE", "whether a notch filter is needed is not known"),
    ],
)
def test_notch_filters_in_the_log_count_more_than_the_version(parameter, words):
    telemetry = HOVER.telemetry(parameters={parameter: 0.0})
    telemetry = replace(telemetry, firmware="ArduCopter V3.6.7 (bd817897)")
    slow = Fact(NotchAdvice.SPECTRUM_BELOW_MOTORS, highest=12.5, rotor_frequency=None)
    assert words in notch_for_firmware(slow, telemetry).sentence


def test_a_line_at_the_frequency_of_a_limit_cycle_is_named_after_it():
    """The control loops oscillate at 26 Hz about roll; the line at 90 Hz is another one."""
    at_oscillation = SpectralLine(LineCause.UNNAMED, 25.6, 400.0, 1.0, 1.0, None)
    elsewhere = at_oscillation._replace(frequency=90.0)
    of_motors = at_oscillation._replace(cause=LineCause.MOTOR)
    limit_cycle = Oscillation("roll", 26.0, 10.0, 0.14, False, 6.0, Segment(0, 10.0, 16.0))
    lines = (at_oscillation, elsewhere, of_motors)
    named = lines_with_oscillation(lines, limit_cycle)
    causes = [line.cause for line in named]
    assert causes == [LineCause.OSCILLATION, LineCause.UNNAMED, LineCause.MOTOR]
    assert lines_with_oscillation(lines, None) == lines
