"""Assess: one judgement of a whole log, which every surface shows: headline, next step, lights, events and loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mavdem.assessment.autopilot_messages import in_time_order
from mavdem.assessment.axis import AxisFigures, LogAnalysis, Options, analyse
from mavdem.assessment.axis.analysis import StepProgress, silent
from mavdem.assessment.axis.figures import ALL
from mavdem.assessment.axis.findings import known_wind
from mavdem.assessment.axis.gains import autotuned
from mavdem.assessment.axis.loops import loops_of_axes
from mavdem.assessment.axis.responses import Responses, responses_of
from mavdem.assessment.ending import ending_of
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.inventory import Seen
from mavdem.assessment.judgement import Judgement, judge, unjudged
from mavdem.assessment.lights.log import simulated_of
from mavdem.assessment.motion import motion_events
from mavdem.assessment.noise_spectra import MeasuredNoise, noise_of
from mavdem.assessment.reported import reported_events
from mavdem.containers import JsonValues
from mavdem.dataset.axes import AXES
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.signals import Signals
from mavdem.dem import Learned
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.assessment import NoModel
from mavdem.files import AnyPath
from mavdem.flight import boot_number
from mavdem.immutable import ReadOnlyDict, freeze
from mavdem.ingest import Log, read_log
from mavdem.loops.axis_loops import Loop
from mavdem.loops.loop_construction import loop_from_plant
from mavdem.motors.loss_detection import MotorAlarm, losses_of
from mavdem.vibration.spectra import Spectrum
from mavdem.wind_velocity.estimation import WindVelocity, torque_share_of_wind
from mavdem.wind_velocity.from_log import WindEvidence, wind_evidence


class NoLoop(NamedTuple):
    """Why the loops of an axis are not known."""

    refusal: Fact


@dataclass(frozen=True, eq=False)
class Assessment:
    """What happened in a log, what its vehicle is, and what the figures are good for; ``str`` is the screen.

    Attributes:
        log: what was read.
        judgement: its headline, next step and lights.
        evidence: what that rests on; None where no vehicle of the log was judged.
        analyses: all that the log says of each axis that was modelled, the most important first.
    """

    log: Log
    judgement: Judgement
    evidence: Evidence | None = None
    analyses: ReadOnlyDict[str, LogAnalysis] = field(default_factory=ReadOnlyDict)

    @property
    def analysis(self) -> LogAnalysis | None:
        """What the log says of the first axis that was modelled; None where no vehicle was judged."""
        return next(iter(self.analyses.values()), None)

    @property
    def seen(self) -> Seen:
        """What an inventory of the log has of the vehicle."""
        assert self.analysis is not None and self.evidence is not None
        analysis = self.analysis
        return Seen(
            self.evidence.signals.telemetry,
            analysis.learnability,
            analysis.condition,
            analysis.identity,
        )

    def with_axis(self, axis: str) -> Assessment:
        """Returns the same with an analysis of a further ``axis``."""
        assert self.evidence is not None
        signals = self.evidence.signals
        analysis = analyse(self.log, signals, axis, other_axis=self.analysis)
        return replace(self, analyses=ReadOnlyDict(self.analyses | {axis: analysis}))

    @property
    def headline(self) -> Fact:
        """The worst event or light, or how the flight was lost."""
        return self.judgement.headline

    @property
    def next_step(self) -> Fact:
        """What to do about it."""
        return self.judgement.next_step

    @property
    def lights(self) -> NamedFacts:
        """The judgement of motors, vibration, tracking, margins, power, estimator, wind and log, by name."""
        return self.judgement.lights

    @property
    def simulated(self) -> Fact | None:
        """That the flight was simulated; None where nothing in the log shows it."""
        return None if self.evidence is None else simulated_of(self.evidence)

    @property
    def events(self) -> Facts:
        """What happened, in order."""
        return () if self.evidence is None else self.evidence.events

    @property
    def loops(self) -> Mapping[str, Loop | NoLoop]:
        """The control loops of "roll", "pitch" and "yaw", or their ``refusal``."""
        loops = dict.fromkeys(AXES, self.headline) if self.evidence is None else self.evidence.loops
        return ReadOnlyDict(
            {axis: NoLoop(loop) if isinstance(loop, Fact) else loop for axis, loop in loops.items()}
        )

    @cached_property
    def responses(self) -> Responses:
        """The measured responses of "rate" and "attitude" of each axis, beside the predicted ones."""
        return {} if self.evidence is None else freeze(responses_of(self.evidence))

    @cached_property
    def noise(self) -> MeasuredNoise:
        """The spectra of gyro and accelerometer, lines in them, and the notch filter to set."""
        return freeze(MeasuredNoise({}, {}) if self.evidence is None else noise_of(self.evidence))

    @property
    def spectra(self) -> Mapping[str, Spectrum]:
        """The spectra of gyro, accelerometer and demand, by name."""
        return self.noise.spectra

    @property
    def model(self) -> Learned | None:
        """The model of the axis, where the log allows one."""
        return None if self.analysis is None else self.analysis.learned

    @property
    def wind(self) -> WindVelocity | None:
        """The wind in m/s, where it is known."""
        return None if self.evidence is None else self.evidence.air.estimate

    @cached_property
    def wind_of_model(self) -> WindVelocity | None:
        """The wind where it is on one clock with what the model was trained on."""
        if self.wind is None or self.analysis is None or not self.analysis.flights:
            return None
        boot = boot_number(self.analysis.flights[0])
        return self.wind if self.wind.boot == boot else None

    @cached_property
    def explained(self) -> Fact | None:
        """What share of a known wind torque the mean wind explains."""
        if self.analysis is None or self.model is None or self.wind_of_model is None:
            return None
        torque = known_wind(self.model.wind_torque, self.model.physical)
        if torque is None:
            return None
        time = np.concatenate([flight.time for flight in self.analysis.flights])
        return torque_share_of_wind(self.wind_of_model, time, torque.torque)

    @property
    def refusal(self) -> NotLearnable:
        """Why there is no model, and what to do next."""
        because = self.headline if self.analysis is None else self.analysis.reason
        return NotLearnable(NoModel.REFUSED, because=because, next_step=self.next_step)

    @property
    def of_documents(self) -> JsonValues:
        """What every document says of a flight."""
        return {**vars(self.judgement), "events": self.events}

    def sentence(self, fact: Fact) -> str:
        """Returns a ``fact`` in words."""
        return fact.sentence

    def page(self, path: str | PathLike[str]) -> None:
        """Writes its page to ``path``: one HTML file with pictures, to be read without a network."""
        from mavdem.report.flight_page import review_page

        Path(path).write_text(review_page(self), "utf-8", "replace")

    def as_dict(self) -> JsonValues:
        """Returns the document of ``mavdem review --json``, plain JSON values."""
        from mavdem.documents import whole
        from mavdem.documents.review import review_document

        return whole("review", review_document(self))

    def __str__(self) -> str:
        from mavdem.report.review import screen_of

        return screen_of(self)


def review(path: AnyPath, vehicle: str | None = None) -> Assessment:
    """Returns the assessment of a log: what happened, what its vehicle is, and what the figures are good for.

    >>> a = mavdem.review("flight.tlog")
    >>> [*a.lights][:4], [*a.loops], a.model is not None
    (['motors', 'vibration', 'tracking', 'margins'], ['roll', 'pitch', 'yaw'], True)

    Args:
        path: a log that ``mavdem.ingest.read_log`` reads.
        vehicle: "system" or "system:component", where the log holds several; without, the headline lists them.

    Raises:
        Unreadable: the log cannot be read.
        ValueError: ``path`` is no path.
    """
    return assess(read_log(path), vehicle)


def assess(
    log: Log,
    vehicle: str | None = None,
    axis: str = ALL,
    options: Options | None = None,
    *,
    progress: StepProgress = silent,
) -> Assessment:
    """Returns the assessment of a ``vehicle`` of a ``log`` with a model of an ``axis``, as :func:`mavdem.review` does.

    Its ``analysis`` is that of :func:`mavdem.assessment.axis.analyse`, which raises what it
    raises and shows its ``progress``. Of ``options`` without ``whole`` there is no model.
    """
    try:
        signals = Signals(choose_vehicle(log.vehicles, vehicle))
    except NotLearnable as error:
        return Assessment(log, unjudged(error.fact))
    return assess_signals(log, signals, axis, options, progress=progress)


@np.errstate(all="ignore")  # of a message's numbers, some are none
def assess_signals(
    log: Log,
    signals: Signals,
    axis: str = ALL,
    options: Options | None = None,
    *,
    progress: StepProgress = silent,
) -> Assessment:
    """Returns the assessment of the vehicle of these ``signals`` of a ``log``, as :func:`assess` does."""
    options = options or Options()
    air = wind_evidence(
        signals
    )  # first: what it reads of the signals the analysis need not read again
    analysis = analyse(log, signals, axis, options, progress=progress)
    with progress("Identifying the loops", measured=False):
        about = signals.for_axis(AXES[0], options.inputs)
        loops = loops_of_axes(log, about, options.start, analysis.axis_figures)
    events = [*reported_events(signals), *motion_events(signals)]
    tuned = [autotuned(about.for_axis(axis), loop) for axis, loop in loops.items()]
    ending = ending_of(signals, events, analysis.condition.collective)
    changes = while_controlled(analysis.alarms, ending)
    events += [*losses_of(changes), *(change.fact for change in changes if not change.weak)]
    events += filter(None, [ending, *tuned])
    evidence = Evidence(
        log,
        signals,
        analysis.learnability,
        analysis.condition,
        air,
        tuple(in_time_order(events)),
        ending,
        ReadOnlyDict(loops),
    )
    if evidence.grounds:
        evidence = replace(evidence, air=grounded_air(air))
    judgement = judge(evidence, analysis.findings.purposes)
    analyses = ReadOnlyDict({analysis.learnability.axis: analysis})
    return Assessment(log, judgement, evidence, analyses)


def while_controlled(alarms: Sequence[MotorAlarm], ending: Fact | None) -> list[MotorAlarm]:
    """Returns the ``alarms`` of before control was lost: then the motors' balance says nothing."""
    lost = inf if ending is None or ending.time is None else ending.time
    return [alarm for alarm in alarms if alarm.time < lost]


def grounded_air(air: WindEvidence) -> WindEvidence:
    """Returns what is known of the ``air`` with facts that are grounded."""
    wind, own, reason = air
    if wind is not None:
        wind = replace(wind, reasons={of: fact.grounded for of, fact in wind.reasons.items()})
    return WindEvidence(wind, own, None if reason is None else reason.grounded)


def loop_by(figures: AxisFigures, record: Record | None) -> Loop | Fact:
    """Returns the loops of the physical parameters among the ``figures`` of a ``record``, or why there are none."""
    if figures.physical is None or record is None:
        assert figures.reason is not None
        return figures.reason
    try:
        return loop_from_plant(figures.physical, record)
    except NotLearnable as error:
        return error.fact
