"""The rate loop by system identification: of a recorded flight with a chirped truth, and of known margins."""

import numpy as np
from pytest import approx, mark
from recorded_flights import recorded

from mavdem.assessment.axis.margins import AxisMargins
from mavdem.dataset.segments import recorded_spans
from mavdem.dataset.signals import Signals
from mavdem.facts.margins import MarginsLight
from mavdem.loops.injected_signal import injected_loop
from mavdem.loops.margins import OpenLoop


@mark.slow
def test_the_recorded_flight_has_its_chirped_margins():
    """Of ArduCopter's simulator, by a chirp at the mixer: 20.1 Hz, 19°, 2.8 dB, Ms 4.9. The sweep of roll was cut."""
    signals = Signals(recorded("sitl_raw/ap_sid.BIN.xz"), axis="pitch")
    open_loop = injected_loop(signals, recorded_spans(signals))
    assert open_loop.crossover == approx(20.1, abs=0.3)
    assert open_loop.phase_margin == approx(19, abs=1.5)
    assert open_loop.gain_margin == approx(2.8, abs=1)
    assert open_loop.ms == approx(4.9, rel=0.1)
    assert injected_loop(signals.for_axis("roll"), recorded_spans(signals)) is None


@mark.parametrize("gain, level", [(12.0, "good"), (20.0, "watch"), (24.0, "bad")])
def test_an_integrator_with_dead_time_has_its_margins_and_the_light_of_these(gain, level):
    """The loop K e^(−τs) / s has margins in closed form. With τ = 40 ms, higher gains K make the light worse."""
    delay = 0.04
    frequency = np.geomspace(1, 40, 500)
    s = 2j * np.pi * frequency
    loop = (gain * np.exp(-delay * s) / s)[None]
    open_loop = OpenLoop(frequency, loop)
    assert open_loop.crossover == approx(gain / (2 * np.pi), rel=1e-3)
    assert open_loop.phase_margin == approx(90 - np.degrees(gain * delay), abs=0.1)
    assert open_loop.gain_margin == approx(20 * np.log10(np.pi / (2 * gain * delay)), abs=0.05)
    assert open_loop.delay_margin == approx(np.pi / 2 / gain - delay, abs=1e-4)
    (fact,) = AxisMargins("roll", None, None, None, open_loop).facts
    assert (fact.code, fact.level) == (MarginsLight.LOOP_MEASURED, level)
    assert fact.figures["phase_margin"] == open_loop.phase_margin
