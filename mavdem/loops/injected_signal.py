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
"""Fewest frequencies at which the rate must be coherent with the signal: a crossover lies between two."""


def injected_loop(signals: Signals, segments: Segments) -> OpenLoop | None:
    """Returns the rate loop of one axis, measured where a signal was injected in flight.

    Args:
        signals: of the vehicle and the axis, with the injected signal, the rate and the demand.
        segments: of the flight.

    Returns:
        One loop (N = 1) at the frequencies at which the rate is coherent with the injected signal. Its response to
        torques of wind is not measured, and 0. None without a signal or the autopilot's gains, or where the loop does
        not cross over at these frequencies.
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
    # Signals may have been injected at several points of the loop: the one with most samples counts.
    injected = max(injected_signals, key=lambda series: len(series.time))
    demand_series = replace(
        injected, time=demand.time, boot=demand.boot, values=demand.outputs[:, 0]
    )
    rate, _ = signals.rate_and_setpoint
    spectra = welch_spectra((injected, rate, demand_series), segments)
    if spectra is None:
        return None
    is_measured = spectra.coherence >= MIN_COHERENCE
    is_measured &= spectra.frequency >= MIN_RESPONSE_FREQUENCY
    if np.count_nonzero(is_measured) < MIN_FREQUENCIES:
        return None
    frequency = spectra.frequency[is_measured]
    # The plant is the response from demand to rate. Wind and noise move both, but are not coherent with the injected
    # signal: so the plant is the ratio of the cross-spectra with that signal (index 0), of the rate (1) and the demand
    # (2).
    to_rate, to_demand = spectra.power[0, 1], spectra.power[0, 2]
    plant = (to_rate / to_demand)[is_measured]
    from_setpoint, from_rate = controller_response(controller, frequency)
    response = from_rate * plant
    closed = from_setpoint * plant / (1 + response)
    loop = OpenLoop(frequency, response[None], closed[None], disturbance=0 * closed[None])
    return loop if isfinite(loop.crossover) else None
