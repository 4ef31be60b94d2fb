"""Noise: the spectra of gyro and accelerometer in flight, their lines, and what the filters leave of them."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mavdem.assessment.evidence import Evidence
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.segments import Segment
from mavdem.facts import Fact, Facts
from mavdem.facts.noise import Noise as Codes
from mavdem.loops.axis_loops import Loop
from mavdem.loops.resonance import controller_if_known
from mavdem.vibration.notch_filters import LINE_BAND, notch_advice
from mavdem.vibration.spectra import Spectrum, vibration_spectra
from mavdem.vibration.spectral_lines import LineKind, SpectralLine, find_spectral_lines

KINDS = {
    LineKind.MOTOR: Codes.MOTOR_LINE,
    LineKind.FRAME: Codes.FRAME_LINE,
    LineKind.ALIAS: Codes.ALIASED_LINE,
    LineKind.UNNAMED: Codes.UNNAMED_LINE,
}
GYRO = "gyro"
BEFORE = "gyro_before"


class MeasuredNoise(NamedTuple):
    """The spectra by name, and the lines of each."""

    spectra: Mapping[str, Spectrum]
    peaks: Mapping[str, tuple[SpectralLine, ...]]
    notch: Fact | None = None
    """The notch filter to set, or why there is none; None where the filters are not known."""

    @property
    def lines(self) -> tuple[SpectralLine, ...]:
        """Those of the gyro before its filters, where that was logged, or else behind them."""
        return self.peaks.get(BEFORE, self.peaks.get(GYRO, ()))

    @property
    def facts(self) -> Facts:
        """What the gyro shows, up to which frequency, and what the filters take."""
        shown = self.spectra.get(BEFORE, self.spectra.get(GYRO))
        if shown is None:
            return (Fact(Codes.NO_SPECTRUM),)
        facts = [
            Fact(
                Codes.SPECTRUM_SEEN,
                name=shown.name,
                source=shown.source,
                highest=shown.nyquist_frequency,
                windows=len(shown.time),
            )
        ]
        facts += [
            Fact(
                KINDS[peak.kind],
                frequency=peak.frequency,
                ratio=peak.ratio,
                harmonics=peak.harmonics,
                exponent=peak.exponent,
                order=peak.order,
            )
            for peak in self.lines
        ]
        behind = self.spectra.get(GYRO)
        if shown.name == BEFORE and behind is not None:
            facts += [
                _left(peak, shown, behind)
                for peak in self.lines
                if peak.kind is LineKind.MOTOR and peak.frequency < behind.nyquist_frequency
            ]
        return tuple(filter(None, (*facts, self.notch)))


def noise_of(evidence: Evidence) -> MeasuredNoise:
    """Returns the spectra and lines of all that was flown, and a notch with what it costs the identified loops."""
    signals = evidence.signals
    if signals.attitude is None:
        return MeasuredNoise({}, {})
    boots = np.unique(signals.attitude.boot).tolist()
    spans = [Segment(boot, *span) for boot in boots for span in evidence.flights(boot)]
    spectra = vibration_spectra(signals, spans)
    noise = MeasuredNoise(
        spectra, {name: find_spectral_lines(spectrum) for name, spectrum in spectra.items()}
    )
    controller = controller_if_known(signals.for_axis("roll"))
    if controller is None:
        return noise
    before, behind = spectra.get(BEFORE), spectra.get(GYRO)
    loops = (evidence.loops.get(axis) for axis in TILT_AXES)
    crossovers = (loop.crossover for loop in loops if isinstance(loop, Loop))
    crossover = max(crossovers, default=None)
    return noise._replace(notch=notch_advice(controller, noise.lines, before, behind, crossover))


def _left(peak: SpectralLine, before: Spectrum, behind: Spectrum) -> Fact:
    """What the filters leave of a line."""
    sides = np.multiply(LINE_BAND, peak.frequency)
    share = behind.mean_power(*sides) / before.mean_power(*sides)
    return Fact(Codes.FILTERS_REMOVE, frequency=peak.frequency, share=1 - share)
