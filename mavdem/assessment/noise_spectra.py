"""Noise of a flight: spectra of gyro and accelerometer, and facts (coded findings) about lines, filters and notch."""

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from mavdem.assessment.evidence import Evidence
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.facts import Fact, Facts
from mavdem.facts.noise import NoiseFact, NotchAdvice
from mavdem.ingest.telemetry import Telemetry, firmware_version
from mavdem.loops.axis_loops import Loop
from mavdem.loops.demand_noise import GyroNoise, noise_above_motion
from mavdem.loops.filters import gyro_response
from mavdem.loops.limit_cycles import Oscillation
from mavdem.loops.resonance import controller_if_known
from mavdem.vibration.notch_filters import LINE_BAND, notch_advice
from mavdem.vibration.spectra import Spectrum, vibration_spectra
from mavdem.vibration.spectral_lines import (
    MIN_SEPARATION,
    LineCause,
    SpectralLine,
    find_spectral_lines,
)

LINE_CODES = {
    LineCause.MOTOR: NoiseFact.MOTOR_LINE,
    LineCause.FRAME: NoiseFact.FRAME_LINE,
    LineCause.ALIAS: NoiseFact.ALIASED_LINE,
    LineCause.OSCILLATION: NoiseFact.OSCILLATION_LINE,
    LineCause.UNNAMED: NoiseFact.UNNAMED_LINE,
}
"""Codes of the facts about spectral lines, by the cause of the line."""

GYRO = "gyro"
"""Name of the spectrum of the gyro after its filters."""

UNFILTERED_GYRO = "gyro_before"
"""Name of the spectrum of the gyro before its filters."""

SAME_RATE_RATIO = 0.9
"""Ratio of two sampling rates from which they are the same: rates of logs vary by a few percent. A choice."""


FIRST_VERSION_WITH_BATCHES = (3, 6)
"""First version of ArduCopter that logs its gyro in batches of fast samples (INS_LOG_BAT_MASK)."""

FIRST_VERSION_WITH_NOTCH = (4, 0)
"""First version of ArduCopter with a harmonic notch filter (INS_HNTCH_ENABLE)."""

MOVING_NOTCH = "INS_HNTCH_ENABLE"
"""Parameter that switches on ArduPilot's harmonic notch filter, which follows the motors."""

FIXED_NOTCH = "INS_NOTCH_ENABLE"
"""Parameter that switches on its notch filter at a fixed frequency."""


class MeasuredNoise(NamedTuple):
    """Spectra of the sensors in flight, and what follows from them."""

    spectra: Mapping[str, Spectrum]
    """Spectra by name: ``GYRO``, ``UNFILTERED_GYRO`` and the spectra of other sensors."""
    peaks: Mapping[str, tuple[SpectralLine, ...]]
    """Lines of each spectrum, by its name, the strongest first."""
    notch: Fact | None = None
    """The notch filter to set, or why there is none; None if the filters are not known."""
    no_spectrum: Fact = Fact(NoiseFact.NO_SPECTRUM)
    """That there is no spectrum, where there is none; the autopilot decides what it advises to log."""

    @property
    def gyro_spectrum(self) -> Spectrum | None:
        """The spectrum of the gyro before its filters or, if that was not logged, after them; None without either."""
        return self.spectra.get(UNFILTERED_GYRO, self.spectra.get(GYRO))

    @property
    def lines(self) -> tuple[SpectralLine, ...]:
        """Lines of the gyro before its filters or, if that was not logged, after them."""
        return self.peaks.get(UNFILTERED_GYRO, self.peaks.get(GYRO, ()))

    def slow_filtered_spectrum(self, sensor: str) -> Spectrum | None:
        """Returns the spectrum of a filtered sensor if the filtered samples were logged more slowly than the raw ones.

        Such a spectrum is aliased: what the filters pass above half of its sampling rate is folded below. So it may
        exceed the spectrum of the raw samples, which filters alone cannot cause.

        Args:
            sensor: name of the sensor, such as "gyro".

        Returns:
            The spectrum; None if it is as fast as that of the raw samples, or one of both is missing.
        """
        filtered = self.spectra.get(sensor)
        unfiltered = self.spectra.get(f"{sensor}_before")
        if filtered is None or unfiltered is None:
            return None
        is_slow = filtered.nyquist_frequency < SAME_RATE_RATIO * unfiltered.nyquist_frequency
        return filtered if is_slow else None

    @property
    def facts(self) -> Facts:
        """The facts (coded findings) about the noise of the gyro, or the one fact that there is no spectrum of it.

        They are the spectrum, its lines, the fraction of each motor line that the gyro's filters remove, and the notch
        filter to set. The spectrum before the filters is preferred, since it shows all lines. The removed shares are
        known only if the gyro was logged both before and after the filters.
        """
        filtered_gyro = self.spectra.get(GYRO)
        unfiltered_gyro = self.spectra.get(UNFILTERED_GYRO)
        if self.gyro_spectrum is None:
            return (self.no_spectrum,)
        facts = [_spectrum_fact(self.gyro_spectrum)]
        for line in self.lines:
            facts.append(_line_fact(line))
        if unfiltered_gyro is not None and filtered_gyro is not None:
            facts += self._filter_facts(unfiltered_gyro, filtered_gyro)
        if self.notch is not None:
            facts.append(self.notch)
        return tuple(facts)

    def _filter_facts(self, unfiltered_gyro: Spectrum, filtered_gyro: Spectrum) -> Iterator[Fact]:
        """Yields a fact for each motor line with the ``share`` of its power that the gyro's filters remove, 0 to 1.

        The power is the mean in a band about the frequency of the line (``LINE_BAND``). Lines above the Nyquist
        frequency of the filtered gyro cannot be compared, and are skipped. So is a line that has more power after the
        filters: that is faster vibration, folded at that frequency.

        Args:
            unfiltered_gyro: spectrum of the gyro before its filters.
            filtered_gyro: spectrum of the gyro after its filters.
        """
        for line in self.lines:
            if line.cause is LineCause.MOTOR and line.frequency < filtered_gyro.nyquist_frequency:
                # The ends of the band about the line, Hz.
                lower, upper = np.multiply(LINE_BAND, line.frequency)
                power_after = filtered_gyro.mean_power(lower, upper)
                power_before = unfiltered_gyro.mean_power(lower, upper)
                removed_share = 1 - power_after / power_before
                if removed_share > 0:
                    yield Fact(
                        NoiseFact.FILTERS_REMOVE, frequency=line.frequency, share=removed_share
                    )


def _spectrum_fact(spectrum: Spectrum) -> Fact:
    """Returns the fact (coded finding) that says which spectrum was measured, and how far it reaches.

    Args:
        spectrum: an averaged power spectrum of a sensor.

    Returns:
        A fact with the ``name`` of the sensor, the ``source`` (its message), the ``highest`` frequency (the Nyquist
        frequency, Hz; faster vibration is aliased below it), and the number of averaged ``windows``.
    """
    return Fact(
        NoiseFact.SPECTRUM_SEEN,
        name=spectrum.name,
        source=spectrum.source,
        highest=spectrum.nyquist_frequency,
        windows=len(spectrum.time),
    )


def _line_fact(line: SpectralLine) -> Fact:
    """Returns the fact of a spectral line; its code says what causes the line, such as a motor or the frame.

    Args:
        line: a peak of a spectrum.

    Returns:
        A fact (coded finding) with the ``frequency``, Hz; the ``ratio`` of its power to that around it; its
        ``harmonics``; the ``exponent`` p if the frequency is proportional to throttle or motor speed to the power p;
        and the ``order``, the frequency over the frequency of the motors' rotation.
    """
    return Fact(
        LINE_CODES[line.cause],
        frequency=line.frequency,
        ratio=line.ratio,
        harmonics=line.harmonics,
        exponent=line.exponent,
        order=line.order,
    )


def measure_noise(evidence: Evidence) -> MeasuredNoise:
    """Measures the noise of a flight: spectra of the sensors, their lines, and the notch filter to set.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The noise, from samples in flight only. Without an attitude it has no spectra, and without a known controller no
        notch filter.
    """
    signals = evidence.signals
    no_spectrum = _with_logging_ability(Fact(NoiseFact.NO_SPECTRUM), signals.telemetry)
    if signals.attitude is None:
        return MeasuredNoise({}, {}, no_spectrum=no_spectrum)
    spectra = vibration_spectra(signals, evidence.flight_segments(signals.attitude.boot))
    limit_cycle = evidence.condition.oscillation
    lines = {}
    for name, spectrum in spectra.items():
        lines[name] = lines_with_oscillation(find_spectral_lines(spectrum), limit_cycle)
    noise = MeasuredNoise(spectra, lines, no_spectrum=no_spectrum)
    return noise._replace(notch=_advised_notch(evidence, noise))


def lines_with_oscillation(
    lines: Iterable[SpectralLine], limit_cycle: Oscillation | None
) -> tuple[SpectralLine, ...]:
    """Returns the lines of a spectrum, of which those at the frequency of an oscillation are named after it.

    Args:
        lines: the lines. Only those of unknown cause may get this name.
        limit_cycle: the oscillation of the control loops, with those of the other axes; None without one.
    """
    if limit_cycle is None:
        return tuple(lines)
    cycles = (limit_cycle, *limit_cycle.other_axes)
    frequencies = [cycle.frequency for cycle in cycles if cycle.frequency is not None]
    named_lines = []
    for line in lines:
        is_oscillation = any(
            abs(line.frequency - frequency) <= MIN_SEPARATION * frequency
            for frequency in frequencies
        )
        if is_oscillation and line.cause is LineCause.UNNAMED:
            line = line._replace(cause=LineCause.OSCILLATION)
        named_lines.append(line)
    return tuple(named_lines)


def gyro_noise_by_axis(noise: MeasuredNoise, loops: Iterable[Loop]) -> dict[str, GyroNoise]:
    """Returns the noise of the gyro after its filters about the axes of some loops, above the motion of the vehicle.

    Args:
        noise: the spectra of a flight. The spectrum before the filters is preferred, since it reaches higher; the
            filters of the loop's controller are then applied to it.
        loops: identified loops with the logged gains.

    Returns:
        The noise by axis. An axis is left out if its spectrum shows less than an octave of noise.
    """
    spectrum = noise.gyro_spectrum
    noise_by_axis = dict[str, GyroNoise]()
    if spectrum is None:
        return noise_by_axis
    for loop in loops:
        controller = loop.controller
        sampling_rate = min(2 * spectrum.nyquist_frequency, 1 / controller.loop_period)
        density = spectrum.mean_density[AXES.index(loop.axis)]
        if spectrum.name == UNFILTERED_GYRO:
            density = density * np.abs(gyro_response(controller, spectrum.frequency)) ** 2
        noise_of_axis = noise_above_motion(loop, spectrum.frequency, density, sampling_rate)
        if noise_of_axis is not None:
            noise_by_axis[loop.axis] = noise_of_axis
    return noise_by_axis


def _advised_notch(evidence: Evidence, noise: MeasuredNoise) -> Fact | None:
    """Returns the notch filter to set in the gyro's signal, or why there is none; None without a known controller.

    Args:
        evidence: signals, events and measurements of the vehicle, with the identified loops of roll and pitch. A notch
            filter costs phase at their crossover.
        noise: spectra of the sensors, and their lines.
    """
    signals = evidence.signals
    controller = controller_if_known(signals.for_axis("roll"))
    if controller is None:
        return None
    loops = [evidence.loops.get(axis) for axis in TILT_AXES]
    crossovers = [loop.crossover for loop in loops if isinstance(loop, Loop)]
    notch = notch_advice(
        controller,
        noise.lines,
        noise.spectra.get(UNFILTERED_GYRO),
        noise.spectra.get(GYRO),
        max(crossovers, default=None),
    )
    return notch_for_firmware(notch, signals.telemetry)


def notch_for_firmware(notch: Fact, telemetry: Telemetry) -> Fact:
    """Replaces the advice on a notch filter if the firmware of the vehicle has no such filter.

    Args:
        notch: a fact (coded finding): the notch filter to set, or why there is none.
        telemetry: autopilot and firmware of the vehicle.

    Returns:
        - ``NO_NOTCH_IN_FIRMWARE`` if the firmware has no moving notch, although one is to be set or may be needed,
          since the spectrum ends below the motors' frequencies. The parameters in the log show that more surely than
          the version: some builds had the filter earlier.
        - Otherwise ``notch``. If the spectrum ends too low, its advice on logging is fitted to this autopilot.
    """
    may_be_needed = notch.code in (NotchAdvice.SET_NOTCH, NotchAdvice.SPECTRUM_BELOW_MOTORS)
    has_moving_notch = MOVING_NOTCH in telemetry.parameters
    if may_be_needed and not (
        has_moving_notch or _is_from_version(telemetry, FIRST_VERSION_WITH_NOTCH)
    ):
        return Fact(
            NotchAdvice.NO_NOTCH_IN_FIRMWARE,
            firmware=telemetry.firmware,
            has_fixed_notch=FIXED_NOTCH in telemetry.parameters,
        )
    if notch.code is NotchAdvice.SPECTRUM_BELOW_MOTORS:
        return _with_logging_ability(notch, telemetry)
    return notch


def _with_logging_ability(fact: Fact, telemetry: Telemetry) -> Fact:
    """Adds to a finding whether the autopilot can log its gyro faster, so that the advice fits the autopilot.

    Args:
        fact: the finding that the gyro has no spectrum, or one that ends below the motors' frequencies.
        telemetry: autopilot and firmware of the vehicle.

    Returns:
        The finding with two more figures: the name of the ``autopilot``, and as ``can_log``, whether its firmware can
        log the gyro fast enough for such a spectrum. PX4 always can; ArduCopter can from some version on.
    """
    can_log_fast_gyro = _is_from_version(telemetry, FIRST_VERSION_WITH_BATCHES)
    return fact.replace(autopilot=telemetry.autopilot, can_log=can_log_fast_gyro)


def _is_from_version(telemetry: Telemetry, first_version: tuple[int, int]) -> bool:
    """Returns whether the firmware is of a version of ArduCopter or newer; true for PX4 and for an unknown version.

    Args:
        telemetry: autopilot and firmware of the vehicle.
        first_version: major and minor version of ArduCopter, the first one with some feature.
    """
    version = firmware_version(telemetry)
    if telemetry.autopilot != "ARDUPILOTMEGA" or version is None:
        return True
    return version >= first_version
