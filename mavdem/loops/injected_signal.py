"""The open rate loop measured with an injected signal (system identification mode), without a model of the vehicle.

A signal v that the autopilot adds to a command depends on neither wind nor noise: it is an instrument (L. Ljung,
System Identification, 2nd ed., sec. 7.6). So the ratio of its cross-spectra with rate p and demand u is the vehicle's
response without the bias of a closed loop, and with the known controller C it gives the open loop:

    P = S_vp / S_vu,    L = C P

Rate and demand come in one message, so that neither is late.
"""

from dataclasses import replace
from math import isfinite

import numpy as np

from mavdem.dataset.segments import Segments
from mavdem.dataset.signals import Signals
from mavdem.loops.margins import OpenLoop, controller_response
from mavdem.loops.resonance import MIN_RESPONSE_FREQUENCY, controller_if_known
from mavdem.loops.welch import MIN_COHERENCE, welch_spectra

MIN_FREQUENCIES = 2
"""Least number of frequencies at which the rate must be coherent with the signal: a crossover lies between two."""


def injected_loop(signals: Signals, segments: Segments) -> OpenLoop | None:
    """Measures the open rate loop of one axis by a signal that was injected in flight (system identification mode).

    The injected signal depends on neither wind nor noise. So the plant, from demand to rate, is the ratio of the
    cross-spectra of rate and demand with the injected signal. The known controller times the plant is the open loop.

    Args:
        signals: signals of the vehicle, for the axis, with the injected signal, the rate and the demand.
        segments: segments of the flight to use.

    Returns:
        One loop (N = 1) at the frequencies at which the rate is coherent with the injected signal. ``None`` if no
        signal was injected, if the autopilot's gains are not known, or if the gain does not cross 1 at these
        frequencies.
    """
    demand = signals.demand
    controller = controller_if_known(signals)
    if (
        demand is None
        or signals.rate_and_setpoint is None
        or not signals.injected_signals
        or controller is None
    ):
        return None
    injected_signals = [injection.signal for injection in signals.injected_signals]
    # Signals may have been injected at several points of the loop. The one with the most samples is used.
    longest_signal = max(injected_signals, key=lambda series: len(series.time))
    demand_series = replace(
        longest_signal, time=demand.time, boot=demand.boot, values=demand.outputs[:, 0]
    )
    rate, _ = signals.rate_and_setpoint
    spectra = welch_spectra((longest_signal, rate, demand_series), segments)
    # Indices of the three signals in the spectra.
    injection_index, rate_index, demand_index = 0, 1, 2
    if spectra is None:
        return None
    is_measured = spectra.coherence >= MIN_COHERENCE
    is_measured &= spectra.frequency >= MIN_RESPONSE_FREQUENCY
    if np.count_nonzero(is_measured) < MIN_FREQUENCIES:
        return None
    frequency = spectra.frequency[is_measured]
    # Wind and noise change rate and demand, but are not coherent with the injected signal, so the ratio does not depend
    # on them.
    injection_to_rate = spectra.power[injection_index, rate_index]
    injection_to_demand = spectra.power[injection_index, demand_index]
    plant = (injection_to_rate / injection_to_demand)[is_measured]
    _, demand_from_rate = controller_response(controller, frequency)
    response = demand_from_rate * plant
    loop = OpenLoop(frequency, response[None])
    return loop if isfinite(loop.crossover) else None
