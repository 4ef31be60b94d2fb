"""The headline and the next step of a live page, with faults of the session such as a lost link."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mavdem.assessment.flight_verdict import FlightVerdict
from mavdem.assessment.judgement import Judgement
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.session import LinkFact, SessionFact
from mavdem.report.blocks import Sentence
from mavdem.report.pages.page_link import PageLink
from mavdem.report.templates import as_clause, headline

if TYPE_CHECKING:
    from mavdem.live.session_status import SessionStatus


def without_place_in_headline(judgement: Judgement) -> Judgement:
    """Returns a judgement whose headline "link lost in flight" does not say where the vehicle was.

    Another part of the page does (:func:`mavdem.report.live.headline_reason`). Other headlines stay as they are.

    Args:
        judgement: the judgement of the vehicle in a live session.
    """
    if judgement.headline.code is not LinkFact.LOST_IN_FLIGHT:
        return judgement
    return replace(judgement, headline=judgement.headline.replace(is_place_stated=True))


def next_step_with_link(
    next_step: Sentence, judgement: Judgement, saved_flight: PageLink | None
) -> Sentence:
    """Returns the next step of a live page, with a link to the page that has what the step is about, if there is one.

    Args:
        next_step: the sentence on the next step of the judgement.
        judgement: the judgement of the vehicle in the session, with its headline and the next step as a fact.
        saved_flight: the page of this flight in the library of a server, where it is over; None for none.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import states_unrepaired_fault

    if states_unrepaired_fault(judgement.next_step):
        unrepaired_fault = judgement.next_step.figures["reason"]
        return next_step._replace(address=_address_of_earlier_flight(unrepaired_fault))
    if saved_flight is not None and judgement.headline.code is SessionFact.RECORDING_JUDGED:
        # The page in the library has what the step needs, such as the advised gains.
        return next_step._replace(address=saved_flight.address)
    return next_step


def are_lights_of_recording(lights: NamedFacts) -> bool:
    """Returns whether the lights of a session, facts by name, are those of its recording, where that has judged any."""
    return any(light.code is SessionFact.LIGHT_OF_RECORDING for light in lights.values())


def page_of_earlier_fault(status: SessionStatus) -> str:
    """Returns the address of the page of the flight whose fault may not have been repaired; empty without one.

    Args:
        status: state of the session now, or at its end.
    """
    fault = status.unrepaired_fault
    return "" if fault is None else _address_of_earlier_flight(fault)


def level_of_earlier_fault(status: SessionStatus) -> Level:
    """Returns the level of a fault of an earlier flight that may not have been repaired: bad if it forbids to fly.

    Args:
        status: state of the session now, or at its end.
    """
    fault = status.unrepaired_fault
    forbids_flight = fault is not None and fault.figures["reason"].forbids_flight
    return Level.BAD if forbids_flight else Level.WATCH


def statement_of_earlier_repair(status: SessionStatus) -> str:
    """Returns what a user confirms with the button that ends the warning of an earlier fault, such as its repair.

    Empty without such a fault.

    Args:
        status: state of the session now, or at its end.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import statement_of_repair

    fault = status.unrepaired_fault
    return "" if fault is None else statement_of_repair(fault)


def _address_of_earlier_flight(unrepaired_fault: Fact) -> str:
    """Returns the address of the page of an earlier flight that had a fault; empty if that flight has no page yet.

    Args:
        unrepaired_fault: the warning that an earlier fault may not have been repaired. Its figure ``reason`` is that
            fault, which may have the address as its figure.
    """
    fault: Fact = unrepaired_fault.figures["reason"]
    address: str = fault.figures.get("address", "")
    return address


def judgement_of_headline(status: SessionStatus) -> Judgement:
    """Returns the judgement whose findings explain the headline of a live page by measurements of sensors.

    - If the headline is on an earlier flight of the session, it is the judgement of that flight.
    - If the headline is the verdict on the recording, which is text without measurements, and the session found the
      same in flight, it is the judgement that the session had made in flight.
    - Otherwise it is the session's present judgement.

    Args:
        status: state of the session now, or at its end.
    """
    judgement = status.session_judgement
    earlier_verdict = verdict_of_headline(status)
    if earlier_verdict is not None:
        return earlier_verdict.judgement
    if judgement.headline.code is not SessionFact.RECORDING_JUDGED:
        return judgement
    judgement_by_session = _judgement_without_recording(status)
    finding = judgement_by_session.headline
    is_same_verdict = str(judgement.headline) in (headline(finding), finding.sentence)
    return judgement_by_session if is_same_verdict else judgement


def verdict_of_headline(status: SessionStatus) -> FlightVerdict | None:
    """Returns the verdict on an earlier flight if it is the headline of a session's page; None for another headline.

    Args:
        status: state of the session now, or at its end.
    """
    verdict = status.worst_earlier_verdict
    if verdict is None or status.session_judgement.headline != verdict.fact:
        return None
    return verdict


def reasons_of_headline(status: SessionStatus, *, are_details_stated: bool) -> list[Sentence]:
    """Returns the sentences below the headline of a live page that explain it, mostly by measurements.

    A session may have several flights. If the headline is on an earlier one, which went worse than the latest, each
    sentence begins with the number of that flight, as in "Flight 2, …".

    Args:
        status: state of the session now, or at its end.
        are_details_stated: whether the page states the details of the fault elsewhere: in its headline, or in the list
            of events.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import headline_reason

    reasons = headline_reason(judgement_of_headline(status), are_details_stated=are_details_stated)
    earlier_verdict = verdict_of_headline(status)
    if earlier_verdict is None:
        return reasons
    return [
        reason._replace(lead=f"Flight {earlier_verdict.number}, {as_clause(reason.lead)}")
        for reason in reasons
    ]


def _judgement_without_recording(status: SessionStatus) -> Judgement:
    """Returns the judgement by what a session found in flight, as if its recording had not been judged afterwards."""
    return replace(status, recording_verdict=None).session_judgement


def headline_by_session(status: SessionStatus) -> Fact:
    """Returns the headline of a session's page as the session found it in flight, to find the events that report it.

    After a flight the headline is the verdict of the recording, which may give other figures for the same motor than
    the events of the session.

    Args:
        status: state of the session now, or at its end.

    Returns:
        The finding of the session, if the recording has the same verdict or finds the same motor bad; else the headline
        of the page.
    """
    page_headline = judgement_of_headline(status).headline
    if page_headline.code is not SessionFact.RECORDING_JUDGED:
        return page_headline
    finding = _judgement_without_recording(status).headline
    motor_name = f"motor {page_headline.figures.get('motor')}"
    # The subject of a finding may have the place of the motor, too, as in "motor 3 (front left)".
    is_on_same_motor = finding.subject.partition(" (")[0] == motor_name
    is_same_fault = finding.is_bad and page_headline.is_bad and is_on_same_motor
    return finding if is_same_fault else page_headline
