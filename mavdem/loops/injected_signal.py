"""Injected: the rate loop as a flight in system identification shows it, without a model of the vehicle.

A signal that the autopilot adds to a command depends on neither wind nor noise. So the ratio of its cross-spectra with
the rate and with the demand is the vehicle's response without the bias of a closed loop (it is an instrument: L. Ljung,
System Identification, 2nd ed., sec. 7.6), and times the known controller it is the open loop. Rate and demand come in
one message, so that neither is late.
"""

from dataclasses import replace
from math import isfinite

import numpy as np

from mavdem.dataset.segments import Segments
from mavdem.dataset.signals import Signals
from mavdem.loops.margins import OpenLoop, controller_response
from mavdem.loops.resonance import (
    LOWEST_RESPONSE,
    MIN_COHERENCE,
    controller_if_known,
    spectra,
)


def injected_loop(signals: Signals, parts: Segments) -> OpenLoop | None:
    """Returns the rate loop of the axis where a signal was injected in ``parts`` of a flight, at its frequencies.

    None without a signal, the gains, or a crossover among the frequencies.
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
    injected = max(
        (signal.signal for signal in signals.injected_signals), key=lambda signal: len(signal.time)
    )
    acted = replace(injected, time=demand.time, boot=demand.boot, values=demand.outputs[:, 0])
    cross = spectra((injected, signals.rate_and_setpoint[0], acted), parts)
    if cross is None:
        return None
    coherent = (cross.coherence >= MIN_COHERENCE) & (cross.frequency >= LOWEST_RESPONSE)
    if np.count_nonzero(coherent) < 2:
        return None
    frequency = cross.frequency[coherent]
    plant = (cross.power[0, 1] / cross.power[0, 2])[coherent]
    forward, back = controller_response(controller, frequency)
    response = back * plant
    closed = forward * plant / (1 + response)
    loop = OpenLoop(frequency, response[None], closed[None], 0 * closed[None])
    return loop if isfinite(loop.crossover) else None
