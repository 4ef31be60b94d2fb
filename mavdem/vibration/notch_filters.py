"""Notch filters: which to set on a line of the gyro's spectrum, what they take of it, and what they cost in phase.

ArduPilot's harmonic notch goes with the root of the throttle, or with the motors' speed where ESCs report it; PX4's
static one stays, its dynamic one goes with that speed. A notch is as narrow as takes ``ENOUGH`` of the line over all
windows of the flight, each with the notch where it would have been. Parameters and recommended values:
https://ardupilot.org/copter/docs/common-imu-notch-filtering.html, https://docs.px4.io/main/en/config_mc/filter_tuning.
"""

from collections.abc import Sequence

import numpy as np

from mavdem.facts import Fact
from mavdem.facts.noise import NotchAdvice
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.controllers import Controller
from mavdem.loops.filters import gyro_filters, gyro_response
from mavdem.loops.resonance import MAX_LOOP_FREQUENCY
from mavdem.vibration.spectra import Spectrum
from mavdem.vibration.spectral_lines import LineKind, SpectralLine

SHARES = (1 / 4, 1 / 3, 1 / 2)  # of the line's frequency: bandwidths, of which the last is usual
ENOUGH = 0.9
NEEDED = (
    0.2  # share of the noise above the loop behind the filters, from which a line is worth a notch
)
ATTENUATION = 40.0  # dB, as ArduPilot has it by default
LINE_BAND = 0.75, 1.35
"""Of a line's frequency, from and to: what counts as its power."""
BY_THROTTLE = 1.0
BY_SPEED = 3.0
"""Of INS_HNTCH_MODE."""


def notch_advice(
    controller: Controller,
    lines: Sequence[SpectralLine],
    before: Spectrum | None,
    behind: Spectrum | None,
    crossover: float | None,
) -> Fact:
    """Returns the notch filter to set on the strongest line of motors or frame, or why there is none.

    The spectra are of the gyro before its filters and behind them, whichever was logged; costs are at a ``crossover``,
    Hz.
    """
    shown = before or behind
    named = [line for line in lines if line.kind in (LineKind.MOTOR, LineKind.FRAME)]
    if shown is None or not named:
        return Fact(NotchAdvice.NO_LINE_TO_REMOVE)
    line = max(named, key=lambda peak: peak.density)
    frequency = line.frequency
    if any(abs(notch.frequency - frequency) < notch.bandwidth / 2 for notch in controller.notches):
        return Fact(NotchAdvice.NOTCH_IN_PLACE, frequency=frequency)
    left = shown.total_density.mean(axis=0)
    if before is not None:
        left = left * abs(gyro_response(controller, shown.frequency)) ** 2
    low, high = LINE_BAND
    of_line = (shown.frequency > low * frequency) & (shown.frequency < high * frequency)
    share = left[of_line].sum() / left[shown.frequency > MAX_LOOP_FREQUENCY].sum()
    if share < NEEDED:
        return Fact(NotchAdvice.NOTCH_NOT_NEEDED, frequency=frequency, share=share)
    # the notch moves as it would have in each window
    drive = np.ones(len(shown.time))
    if line.kind is LineKind.MOTOR and line.order is not None:
        drive = shown.motor_speed / np.median(shown.motor_speed)
    elif line.kind is LineKind.MOTOR and controller.derivative_of_error:
        drive = np.sqrt(shown.throttle / np.median(shown.throttle))
    at = shown.frequency[of_line] / drive[:, None]
    power = shown.total_density[:, of_line]
    for part in SHARES:
        settings = _settings(controller, line, float(f"{part * frequency:.2g}"))
        static = settings
        if "IMU_GYRO_DNF_EN" in settings:
            static = _static_of_px4(line, settings["IMU_GYRO_DNF_BW"])
        changed = controller.with_parameters(static)
        kept = abs(gyro_response(changed, at) / gyro_response(controller, at)) ** 2
        removed = 1 - (power * kept).sum() / power.sum()
        if removed >= ENOUGH:
            break
    cost = None
    if crossover is not None:
        lags = [gyro_filters(chain, crossover).phase_lag for chain in (changed, controller)]
        cost = lags[0] - lags[1]
    return Fact(
        NotchAdvice.SET_NOTCH,
        frequency=frequency,
        share=removed,
        phase_cost=cost,
        crossover=crossover,
        settings=tuple(settings.items()),
    )


def _settings(controller: Controller, line: SpectralLine, bandwidth: float) -> Parameters:
    """The parameters of a notch on a line, by name."""
    mode = 0.0
    if line.kind is LineKind.MOTOR:
        mode = BY_THROTTLE if line.order is None else BY_SPEED
    if controller.derivative_of_error:
        hover = controller.parameters.get("MOT_THST_HOVER", 0.35)
        return {
            "INS_HNTCH_ENABLE": 1.0,
            "INS_HNTCH_MODE": mode,
            "INS_HNTCH_FREQ": float(f"{line.frequency:.3g}"),
            "INS_HNTCH_BW": bandwidth,
            "INS_HNTCH_REF": float(f"{hover:.3g}") if mode == BY_THROTTLE else 1.0,
            "INS_HNTCH_HMNCS": float(sum(1 << (multiple - 1) for multiple in line.harmonics)),
            "INS_HNTCH_ATT": ATTENUATION,
        }
    if mode == BY_SPEED:
        return {
            "IMU_GYRO_DNF_EN": 1.0,
            "IMU_GYRO_DNF_BW": bandwidth,
            "IMU_GYRO_DNF_HMC": float(max(line.harmonics)),
        }
    return _static_of_px4(line, bandwidth)


def _static_of_px4(line: SpectralLine, bandwidth: float) -> Parameters:
    return {"IMU_GYRO_NF0_FRQ": float(f"{line.frequency:.3g}"), "IMU_GYRO_NF0_BW": bandwidth}
