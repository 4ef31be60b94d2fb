"""The assessment of one vehicle of a log: results and facts (coded findings) that screen, pages and documents show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavdem.assessment.axis import LogAnalysis, analyse
from mavdem.assessment.axis.loop_decision import DecisionsByAxis
from mavdem.assessment.axis.margins import AxisMargins
from mavdem.assessment.axis.responses import Responses, measure_responses
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.flight_verdict import FlightVerdict
from mavdem.assessment.flown_flights import flown_flights
from mavdem.assessment.instances import Instance, list_instances
from mavdem.assessment.inventory import VehicleContents, inventory
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.noise_spectra import MeasuredNoise, measure_noise
from mavdem.assessment.separate_flights import RecordedFlight
from mavdem.assessment.severity import severity_rank
from mavdem.assessment.simulation import simulation_fact
from mavdem.assessment.vehicle_verdict import RecordedVehicle, VehicleVerdict
from mavdem.containers import JsonValues
from mavdem.dataset.axes import AXES
from mavdem.dataset.signals import Signals
from mavdem.dem import Learned
from mavdem.dem.parallel import in_second_process
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.assessment import NoModel
from mavdem.facts.session import SessionFact
from mavdem.flight import boot_number
from mavdem.immutable import ReadOnlyDict, freeze
from mavdem.ingest import Log
from mavdem.loops.advice import AdviceByAxis, advised_parameters
from mavdem.loops.axis_loops import Loop, LoopsByAxis
from mavdem.vibration.spectra import Spectrum
from mavdem.wind_velocity.torque_share import torque_share_of_wind
from mavdem.wind_velocity.velocity import WindVelocity
from mavdem.witnesses import SensorTrust

if TYPE_CHECKING:
    from mavdem.assessment.axis.twin import GainTrial


class NoLoop(NamedTuple):
    """Placeholder for the control loops of an axis that are not known."""

    refusal: Fact
    """Why they are not known."""


def analysed_contents(signals: Signals, analysis: LogAnalysis) -> VehicleContents:
    """Returns what a log contains of one vehicle, as the inventory of a log lists it, from an analysis made before.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        analysis: analysis of one of its axes.

    Returns:
        Telemetry, learnability, condition and identity of the vehicle.
    """
    return VehicleContents(
        signals.telemetry, analysis.learnability, analysis.condition, analysis.identity
    )


@dataclass(frozen=True, eq=False)
class Assessment:
    """What happened in a log, the state of its vehicle, its models and control loops; ``str`` is the screen's text.

    Its results are computed in the order of ``mavdem.assessment.assess.assess_signals``. Only what takes seconds and
    few callers need is computed when it is first read: the measured responses, the noise spectra, the advised gains,
    the time history and the contents of the log.
    """

    log: Log
    """The log."""
    judgement: Judgement
    """Headline, next step and lights."""
    evidence: Evidence | None = None
    """What the judgement rests on; None if no vehicle of the log was judged."""
    analyses: ReadOnlyDict[str, LogAnalysis] = field(default_factory=ReadOnlyDict)
    """The models and figures by axis, the most important axis first; empty if no vehicle was judged."""

    recorded_flight: RecordedFlight | None = None
    """Which flight of its recording was assessed, the worst; None if the recording is assessed as a whole."""

    recorded_vehicle: RecordedVehicle | None = None
    """Which vehicle of its recording was assessed, the worst; None if one was chosen or is alone."""

    @property
    def flight_verdicts(self) -> tuple[FlightVerdict, ...]:
        """The verdicts on the flights of a recording, the worst first; empty if it is assessed as a whole.

        The first one is on the flight of this assessment.
        """
        if self.recorded_flight is None:
            return ()
        verdict = self.recorded_flight.flight.verdict(self.judgement)
        return (verdict, *self.recorded_flight.other_verdicts)

    @property
    def vehicle_verdicts(self) -> tuple[VehicleVerdict, ...]:
        """The verdicts on the vehicles of a recording, the worst first; empty if one was chosen or is alone.

        The first one is on the vehicle of this assessment.
        """
        if self.recorded_vehicle is None:
            return ()
        verdict = VehicleVerdict(self.recorded_vehicle.name, self._headline_with_flight)
        return (verdict, *self.recorded_vehicle.other_verdicts)

    @property
    def stated_headline(self) -> Fact:
        """The headline, with the vehicle and the number of the flight if each is one of several."""
        if self.vehicle_verdicts:
            return self.vehicle_verdicts[0].fact
        return self._headline_with_flight

    @property
    def _headline_with_flight(self) -> Fact:
        """The headline, with the number of its flight if that is one of several."""
        return self.flight_verdicts[0].fact if self.flight_verdicts else self.headline

    @cached_property
    def flight_of_headline(self) -> Fact | None:
        """In which of several flights that are judged together the event in the headline was, by its time.

        None for a single flight, and for a headline without a time, such as one on the margins of all flights.
        """
        time = self.headline.time
        if self.evidence is None or time is None:
            return None
        flights = flown_flights(self.evidence.signals)
        boots = {flight.boot for flight in flights}
        # The clock of each boot begins anew, and not every event names its boot.
        is_time_ambiguous = len(boots) > 1
        if len(flights) < 2 or is_time_ambiguous:
            return None
        boot_of_flights = flights[0].boot
        # An event of another boot, which may be at the same time on its clock, was in none of these flights.
        if self.headline.figures.get("boot", boot_of_flights) != boot_of_flights:
            return None
        # These flights may be a part of a recording, whose flights are numbered from 1.
        first_number = 1
        if self.recorded_flight is not None:
            first_number = self.recorded_flight.flight.first_number
        for number, flight in enumerate(flights, start=first_number):
            if flight.start <= time <= flight.end:
                return Fact(
                    SessionFact.FLIGHT_OF_HEADLINE,
                    time=flight.start,
                    end_time=flight.end,
                    number=number,
                )
        return None

    @property
    def has_settled_flight(self) -> bool:
        """Whether the vehicle flew settled, so that its flight allows some kind of model (a tier)."""
        return any(analysis.tier.tier is not None for analysis in self.analyses.values())

    @property
    def severity_key(self) -> tuple[bool, int, int]:
        """Key by which vehicles of a recording are sorted: those that flew come first, and of them the worst.

        A vehicle that was lost before its flight was settled flew too: so does one with another bad headline.
        """
        has_not_flown = not self.has_settled_flight and not self.headline.is_bad
        return has_not_flown, *severity_rank(self.headline)

    @property
    def recorded_signals(self) -> Signals | None:
        """The signals of all flights of the recording; None if no vehicle was judged."""
        if self.recorded_flight is not None:
            return self.recorded_flight.all_signals
        return None if self.evidence is None else self.evidence.signals

    @property
    def headline(self) -> Fact:
        """The worst event or light, or how the flight was lost."""
        return self.judgement.headline

    @property
    def next_step(self) -> Fact:
        """What to do about the headline."""
        return self.judgement.next_step

    @property
    def lights(self) -> NamedFacts:
        """The judgement of motors, vibration, tracking, margins, power, estimator, wind and log, by name."""
        return self.judgement.lights

    @property
    def events(self) -> Facts:
        """What happened, in order of boot and time."""
        return () if self.evidence is None else self.evidence.events

    @property
    def loops(self) -> Mapping[str, Loop | NoLoop]:
        """The identified control loops by axis, "roll", "pitch" and "yaw".

        Each is a ``Loop``, or a ``NoLoop`` whose ``refusal`` is the fact that says why the loop is not known. If the
        log has no vehicle that could be judged, its headline says so, and is the refusal of all three axes.
        """
        if self.evidence is None:
            return ReadOnlyDict({axis: NoLoop(self.headline) for axis in AXES})
        loops: dict[str, Loop | NoLoop] = {}
        for axis, loop in self.evidence.loops.items():
            loops[axis] = NoLoop(loop) if isinstance(loop, Fact) else loop
        return ReadOnlyDict(loops)

    @property
    def identified_loops(self) -> LoopsByAxis:
        """The control loops by axis, for each axis whose loop is known."""
        return {} if self.evidence is None else self.evidence.identified_loops

    @property
    def axes_with_doubtful_loop(self) -> frozenset[str]:
        """The axes whose identified loop a measured response contradicts."""
        return frozenset() if self.evidence is None else self.evidence.axes_with_doubtful_loop

    @property
    def margins(self) -> tuple[AxisMargins, ...]:
        """The stability margins of roll, pitch and yaw; empty if no vehicle was judged."""
        return () if self.evidence is None else self.evidence.margins

    @property
    def loop_decisions(self) -> DecisionsByAxis:
        """What is wrong with the loops of each axis, and what to change."""
        return self.judgement.loop_decisions

    @property
    def tracking(self) -> NamedFacts:
        """How roll, pitch and yaw follow their setpoints, by axis; empty if no vehicle was judged."""
        return {} if self.evidence is None else self.evidence.tracking

    @cached_property
    def instances(self) -> tuple[Instance, ...]:
        """Every battery, estimator, sensor and output of the vehicle, with its range and state."""
        return () if self.evidence is None else list_instances(self.evidence)

    @property
    def trust(self) -> tuple[SensorTrust, ...]:
        """Which sensors can be trusted in each boot; empty if no vehicle was judged."""
        return () if self.evidence is None else self.evidence.trust

    @cached_property
    def responses(self) -> Responses:
        """The measured responses of the "rate" and "attitude" loop of each axis, with the predicted ones."""
        return {} if self.evidence is None else freeze(measure_responses(self.evidence))

    @cached_property
    def noise(self) -> MeasuredNoise:
        """The spectra of gyro and accelerometer, the lines in them, and the notch filter to set."""
        return freeze(
            MeasuredNoise({}, {}) if self.evidence is None else measure_noise(self.evidence)
        )

    @cached_property
    def advised_gains(self) -> AdviceByAxis:
        """The advice on gains by axis, as ``mavdem tune`` gives it, or the fact that says why an axis has none.

        If the control loop of no axis is identified, there is no advice. The mapping is then empty, unless the vehicle
        must not fly: a user who looks for gains must see that, so that the fact stands under the key "all axes".
        """
        # Imported here, since that module imports this one.
        from mavdem.assessment.axis.tuning import tune_loops

        if self.evidence is None:
            return {}
        tuning = tune_loops(self, AXES, is_written=False)
        if tuning.no_loop is None:
            return tuning.axes
        must_not_fly = bool(self.evidence.reasons_not_to_fly)
        if must_not_fly:
            return {"all axes": tuning.no_loop}
        return {}

    @cached_property
    def gain_trial(self) -> GainTrial | Fact | None:
        """The simulated flights of the vehicle's twin with the present and with the advised gains.

        Both follow the recorded setpoints. If the twin cannot be simulated, a fact says why. None if no gains are to be
        changed.
        """
        # Imported here, since the simulator takes time to import, and a log without advice does not need it.
        from mavdem.assessment.axis.twin import try_gains

        gains = advised_parameters(self.advised_gains)
        if self.evidence is None or not gains:
            return None
        return try_gains(self.evidence, gains, in_wind=False)

    def compute_for_page(self) -> None:
        """Computes the cached properties that a page shows, in two processes at a time if there are two cores.

        A second process computes the advised gains and their trial, which takes about as long as the measured responses
        and spectra, which this process computes. Without an identified loop there is no advice, and too little to
        compute for a second process: then the properties are computed when the page reads them.
        """
        if not self.identified_loops:
            return
        with in_second_process(self._advised_gains_and_trial) as wait_for_result:
            # Access to these cached properties computes them.
            _ = self.responses, self.noise
            result = wait_for_result()
        if result is not None:
            # A ``cached_property`` stores its value in the instance's dictionary under its own name. The results of the
            # second process are stored there too, so that they are not computed again.
            advised_gains, gain_trial = freeze(result)
            self.__dict__["advised_gains"] = advised_gains
            self.__dict__["gain_trial"] = gain_trial

    def _advised_gains_and_trial(self) -> tuple[AdviceByAxis, GainTrial | Fact | None]:
        """Returns the advised gains, and the simulated flights with them."""
        return self.advised_gains, self.gain_trial

    @property
    def spectra(self) -> Mapping[str, Spectrum]:
        """The spectra of gyro, accelerometer and demand, by name."""
        return self.noise.spectra

    @property
    def simulated(self) -> Fact | None:
        """That the flight was simulated; None if nothing in the log shows it."""
        return None if self.evidence is None else simulation_fact(self.evidence.signals)

    @property
    def analysis(self) -> LogAnalysis | None:
        """Model and figures of the first axis; None if no vehicle was judged."""
        return next(iter(self.analyses.values()), None)

    @property
    def model(self) -> Learned | None:
        """The model of the first axis; None if the log allows none."""
        return None if self.analysis is None else self.analysis.learned

    @property
    def refusal(self) -> NotLearnable:
        """Why there is no model, and what to do next, as an error that a caller who needs one raises."""
        reason = self.headline if self.analysis is None else self.analysis.reason
        return NotLearnable(NoModel.REFUSED, reason=reason, next_step=self.next_step)

    @property
    def wind(self) -> WindVelocity | None:
        """The wind in m/s; None if it is not known."""
        return None if self.evidence is None else self.evidence.wind.estimate

    @cached_property
    def wind_of_model(self) -> WindVelocity | None:
        """The wind velocity, if it was estimated in the boot of the model's training data: both share a clock then."""
        if self.wind is None or self.analysis is None or not self.analysis.flights:
            return None
        boot = boot_number(self.analysis.flights[0])
        return self.wind if self.wind.boot == boot else None

    @cached_property
    def wind_share_of_torque(self) -> Fact | None:
        """The fraction of the wind torque's variance that the wind velocity explains, as a fact (a code with figures).

        The torque on the axis (rad/s²) is estimated with the learned model, the velocity (m/s) by the vehicle's drag:
        two independent estimates of the same wind. They are compared at the samples that the model was trained on. None
        if one of the two is not known, they are of different boots, or the torque is smaller than its errors.
        """
        wind_velocity = self.wind_of_model
        if self.analysis is None or self.model is None or wind_velocity is None:
            return None
        # This is None if the torque is smaller than its errors.
        wind_torque = self.model.resolved_wind_torque
        if wind_torque is None:
            return None
        training_time = np.concatenate([flight.time for flight in self.analysis.flights])
        return torque_share_of_wind(wind_velocity, training_time, wind_torque.torque)

    @property
    def contents(self) -> VehicleContents:
        """What the log contains of the vehicle, as ``mavdem info`` lists it: telemetry, condition, identity.

        It must only be used if a vehicle was judged, since there is no evidence otherwise.
        """
        assert self.analysis is not None and self.evidence is not None
        return analysed_contents(self.evidence.signals, self.analysis)

    @cached_property
    def log_contents(self) -> JsonValues:
        """The inventory of the log as JSON values: its vehicles, with their messages and instances.

        ``mavdem info --json`` prints them. The entry of the vehicle that was assessed also has the judgement of its
        flight, the ``judgement_values``, and the model of its motion. If no vehicle was assessed, no entry has these.
        """
        if self.analysis is None or self.evidence is None:
            return inventory(self.log)
        # The contents of the assessed vehicle are passed, so that they are not read again. Its entry is the first one.
        log_inventory = inventory(self.log, [self.contents])
        assessed_vehicle = log_inventory["vehicles"][0]
        assessed_vehicle.update(self.judgement_values)
        assessed_vehicle["model"] = self.analysis.model
        return log_inventory

    @property
    def judgement_values(self) -> JsonValues:
        """The judgement of the flight by the keys that all JSON documents have.

        It consists of the headline (the most serious finding), the next step for the pilot, the lights (eight
        judgements, such as that on the motors) and the events of the flight.
        """
        judgement = self.judgement
        return {
            "headline": judgement.headline,
            "next_step": judgement.next_step,
            "lights": judgement.lights,
            "events": self.events,
        }

    def with_axis(self, axis: str) -> Assessment:
        """Returns the same assessment with an analysis of a further ``axis``, "roll", "pitch" or "yaw"."""
        assert self.evidence is not None
        signals = self.evidence.signals
        analysis = analyse(self.log, signals, axis, other_axis=self.analysis)
        return replace(self, analyses=ReadOnlyDict(self.analyses | {axis: analysis}))

    def sentence(self, fact: Fact) -> str:
        """Returns a ``fact`` in words."""
        return fact.sentence

    def page(self, path: str | PathLike[str]) -> None:
        """Writes the page to ``path``: one HTML file with pictures, which needs no network."""
        from mavdem.report.pages.flight_page import review_page

        Path(path).write_text(review_page(self), "utf-8", "replace")

    def as_dict(self) -> JsonValues:
        """Returns the document of ``mavdem review --json`` as plain JSON values."""
        from mavdem.documents import complete_document
        from mavdem.documents.review import review_document

        return complete_document("review", review_document(self))

    def __str__(self) -> str:
        from mavdem.report.review import review_screen

        return review_screen(self)
