"""The report of a live flight: errors of its predictions, training data, and facts (coded findings)."""

from collections.abc import Mapping, Sequence
from math import isfinite, sqrt
from typing import NamedTuple

from mavdem.assessment.flight_verdict import FlightVerdict
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.limits import LEVELS_BY_SEVERITY
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.assessment import NextStep
from mavdem.facts.event import Event
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.session import LinkFact, SessionFact, TimeUse
from mavdem.facts.watch import WatchFact
from mavdem.fleet.names import GivenNames
from mavdem.live.event_cause import cause_of_alarm
from mavdem.live.history import REPORTED_HORIZON, HorizonErrors, LiveHistory
from mavdem.live.session_state import HEADLINES_WITHOUT_ALARM
from mavdem.live.session_status import SessionStatus
from mavdem.motors.motor_changes import FALSE_ALARMS
from mavdem.report.blocks import Blocks, Sentence, Table, shortened
from mavdem.report.numbers import display_unit, name_with_unit
from mavdem.report.templates import (
    BAN,
    as_clause,
    capitalize_first,
    first_clause,
    headline,
    render_section,
    time_of_day,
    without_full_stop,
)
from mavdem.report.why import headline_evidence

NEXT_STEP_LEAD = "Next: "
"""Beginning of the line with the next step."""

MAX_FIGURE_LENGTH = 50
"""Most characters of the figure of a light on a page: two lines of a light on a telephone."""

FAULTS_SHOWN_ELSEWHERE = (
    SessionFact.FLIGHT_VERDICT,
    SessionFact.UNREPAIRED_FAULT,
    LinkFact.LOST_IN_FLIGHT,
)
"""Headlines without measurements below them: faults of an earlier flight, whose measurements stand with that flight,
and a lost link, which has its last known position there."""


def watched_quantities_text(watch_facts: Sequence[Fact]) -> str:
    """Returns a line for the pilot that lists which quantities a live session watches, and which it does not and why.

    For example: "Watched: battery and vibration (since 62 s); not watched: loss of thrust (no motor outputs are
    received)." A session compares such quantities with their values earlier in the flight, so that it starts to watch
    them after some time in the air. Quantities that are watched since the same second are listed together.

    Args:
        watch_facts: for each quantity a fact (a coded finding): the time since when it is watched, s, or the reason why
            it cannot be.

    Returns:
        The line; empty without facts.
    """
    facts_in_whole_seconds = []
    for fact in watch_facts:
        if fact.time is None:
            facts_in_whole_seconds.append(fact)
        else:
            # The template groups facts of equal time, so that times are rounded to whole seconds.
            start_second = float(round(fact.time))
            facts_in_whole_seconds.append(fact.replace(time=start_second))
    sentences = render_section("live_watched", watch_facts=facts_in_whole_seconds)
    return "".join(f"{capitalize_first(sentence.text)}." for sentence in sentences)


def unwatched_quantities_text(names: Sequence[str]) -> str:
    """Returns a sentence that names what is not watched in a live flight; empty for no names."""
    return " ".join(sentence.text for sentence in render_section("live_unwatched", names=names))


def vehicle_text(status: SessionStatus, *, has_table: bool = False) -> str:
    """Returns in one line the vehicle, its mode, whether it is armed and flies, its battery, and the last message.

    The last message is left out if it is less than a second old.

    Args:
        status: state of the session.
        has_table: whether a table of lights stands below, which has the battery.
    """
    [sentence] = render_section("live_vehicle", status=status, has_table=has_table)
    return sentence.text


def vehicle_state_cells(status: SessionStatus) -> list[Sentence]:
    """Returns mode, height, battery, satellites and link of a vehicle in a few words, which a telephone always shows.

    Each has a level if its colour is to differ: the battery that of the status light "power" if this warns. Once the
    link is lost, it is bad, or a warning while older messages are still read. All other values are from before the
    loss, so that they are unknown now.

    Args:
        status: state of the session.

    Returns:
        A sentence for each that is known, with the value as lead and a remark as text, such as "12 m up", "3 m away".
    """
    # The section of templates "live_strip" has a paragraph for each.
    mode, height, battery, satellites, link = render_section("live_strip", status=status)
    power_light = status.overall_judgement.lights.get(Light.POWER)
    if power_light is not None and power_light.is_watch_or_bad:
        battery = battery._replace(level=power_light.level)
    vehicle_cells = [mode, height, battery, satellites]
    if status.link_loss is not None:
        vehicle_cells = [cell._replace(level=Level.UNKNOWN) for cell in vehicle_cells]
        is_loss_certain = status.link_loss.figures["delay"] is None
        link = link._replace(level=Level.BAD if is_loss_certain else Level.WATCH)
    return [cell for cell in (*vehicle_cells, link) if cell.text]


def status_line_text(status: SessionStatus) -> str:
    """Returns the status of a live session as one line of text, for an output that is not a terminal, such as a file.

    It has the vehicle and its phase of flight, the battery, the lights, the wind, the link, and whether a model is
    learned. From the first take-off on it has the names of the status lights by level, the worst first.

    Args:
        status: state of the session, with the status lights: the judgement of each part of the vehicle by a level.
    """
    judged_lights = status.overall_judgement.lights
    lights_of_levels = []
    for level in reversed(LEVELS_BY_SEVERITY):
        names = [name for name, light in judged_lights.items() if light.level is level]
        if names:
            lights_of_levels.append(f"{level}: {', '.join(names)}")
    # The section of templates "live_line" makes one sentence of all these.
    [sentence] = render_section("live_line", status=status, lights=lights_of_levels)
    return sentence.text


class LightRow(NamedTuple):
    """One light of a live flight, the judgement of one part of the vehicle, as a table shows it."""

    name: str
    """Name of the light, such as "motors"."""

    level: Level
    """Its level, which is also its colour."""

    figure: str
    """Its figure with unit, or what was found so far in a few words; empty where there is neither."""


def _past_fault_or_light(light: Fact) -> Fact:
    """Returns the past fault itself, for a light that only says that an alarm is over; any other light as it is.

    The fault says which part is meant, such as the motor, and has the figures that the table shows.

    Args:
        light: the judgement of one part of the vehicle, such as its motors: a fact (a coded finding) with a level.

    Returns:
        The fault with the level of the light and, if it has no time itself, the time of the light.
    """
    if light.code is not WatchFact.ALARM_OVER:
        return light
    fault = cause_of_alarm(light)
    fault_time = light.time if fault.time is None else fault.time
    return fault.replace(light.level, time=fault_time)


def light_rows(status: SessionStatus) -> list[LightRow]:
    """Returns the rows of the table of status lights of a live flight, one for each part of the vehicle.

    A status light is the judgement of one part, such as the motors or the battery, as a fact (coded finding) with a
    level. Its row has the level and one figure with its unit, such as "15.2 V", or a short text in its place
    (:func:`_light_figure`, :func:`_text_without_figure`).

    Args:
        status: state of the session.
    """
    lights = {}
    for name, light in status.overall_judgement.lights.items():
        lights[name] = _past_fault_or_light(light)
    rows = []
    for name, figure_in_flight in _figures_by_light(lights, status).items():
        light = lights[name]
        figure = _light_figure(name, light, status, figure_in_flight)
        rows.append(LightRow(name, light.level, figure or _text_without_figure(light)))
    return rows


def brief_light_figures(status: SessionStatus) -> dict[str, str]:
    """Returns what each status light of a live flight shows, cut to ``MAX_FIGURE_LENGTH`` characters for a telephone.

    Args:
        status: state of the session.

    Returns:
        The figure or text of each row of :func:`light_rows` by the name of the light, as {"power": "15.2 V"}.
    """
    return {row.name: shortened(row.figure, MAX_FIGURE_LENGTH) for row in light_rows(status)}


def recorded_light_figures(lights: NamedFacts) -> dict[str, str]:
    """Returns the figure of each status light of a recording, such as {"vibration": "1.9 m/s²"}.

    Args:
        lights: the judgement of each part of the vehicle by the recording, a fact (a coded finding), by its name.

    Returns:
        The figures by the names of the lights; empty for a light without a figure.
    """
    # A recording has no present state of the vehicle: a status without any values stands for it.
    return _figures_by_light(lights, status=SessionStatus())


def _figures_by_light(lights: NamedFacts, status: SessionStatus) -> dict[str, str]:
    """Returns the figure of each status light that a table shows, with its unit, such as {"power": "15.2 V"}.

    Args:
        lights: the judgement of each part of the vehicle, a fact (a coded finding), by its name.
        status: state of the session, whose latest messages have some of the figures.

    Returns:
        The figures by the names of the lights, in the order of the table; empty for a light without a figure.
    """
    figures = {}
    # The section of templates "live_lights" has a paragraph for each light: its lead is the name, its text the figure.
    for sentence in render_section("live_lights", status=status, lights=lights):
        figures[sentence.lead] = sentence.text
    return figures


def _light_figure(name: str, light: Fact, status: SessionStatus, figure_in_flight: str) -> str:
    """Returns the figure of a light (judgement of one part of the vehicle), such as the battery's voltage.

    Args:
        name: name of the light.
        light: the fact (coded finding) with the judgement.
        status: state of the session.
        figure_in_flight: its figure by the latest messages of the flight; empty for none.

    Returns:
        The first of these that applies:

        - If the link was lost since the part was judged: how it was then (:func:`_figure_before_silence`).
        - If the recording was judged after the flight: the figure of the recording or, without one, the beginning of
          its sentence.
        - Otherwise ``figure_in_flight``.
    """
    if light.code is Unjudged.KNOWN_BEFORE:
        return _figure_before_silence(name, light, status)
    if light.code is SessionFact.LIGHT_OF_RECORDING:
        # The figures of the session may be others than those of the recording.
        figure_of_recording: str = light.figures.get("figure", "")
        return figure_of_recording or as_clause(first_clause(light.sentence))
    return figure_in_flight


def _figure_before_silence(name: str, light: Fact, status: SessionStatus) -> str:
    """Returns how a part of the vehicle was before its link was lost, such as "good 12 s ago" or "11.4 V 12 s ago".

    Args:
        name: name of the light, the judgement of the part.
        light: the fact that the judgement is of the time before; its ``reason`` is that judgement.
        status: state of the session, with the last voltage of the battery.

    Returns:
        The text; "not known" for a wind that was not known before either, or only roughly.
    """
    is_wind = name == Light.WIND
    if is_wind and not light.figures["reason"].is_good:
        return "not known"
    voltage = None
    if name == Light.POWER and status.state is not None:
        voltage = status.state.voltage
    [paragraph] = render_section(
        "live_light_before",
        duration=light.figures["duration"],
        is_wind=is_wind,
        voltage=voltage,
    )
    return paragraph.text


def _text_without_figure(light: Fact) -> str:
    """Returns what stands in the place of a figure that a light (judgement of one part) does not have.

    Args:
        light: the fact (coded finding) with the judgement.

    Returns:
        The beginning of the sentence of a light that warns; what a light that is not judged waits for or lacks; empty
        for a good light.
    """
    if light.is_watch_or_bad:
        return as_clause(first_clause(light.sentence))
    if light.level is not Level.UNKNOWN:
        return ""
    short_reasons = render_section("live_light_unknown", light=light)
    if short_reasons:
        return " ".join(sentence.text for sentence in short_reasons)
    reason = light.figures.get("reason") or light
    return as_clause(first_clause(reason.sentence))


def live_title(status: SessionStatus, link: str, names: GivenNames) -> str:
    """Returns the title of the page of a live flight, such as "Quadrotor, ArduPilot, vehicle 1".

    If the owner gave the vehicle a name, the title has that name.

    Args:
        status: state of the session.
        link: address of the vehicle, which is the title until a vehicle is followed.
        names: names that were given to vehicles.
    """
    [title] = render_section("live_title", state=status.state, link=link, names=names.vehicles)
    return title.text


def live_alarm(status: SessionStatus) -> str:
    """Returns the alarm of a vehicle in flight in a few words, such as "⚠ Motor 1: land now", for the page's title.

    It is the reason why the vehicle must land. Without such a reason, it is the headline if that is bad. While the link
    is lost, the text begins with that and its age, from the first seconds on, since what was advised before may be out
    of date.

    Args:
        status: state of the session.

    Returns:
        The text; empty if nothing is bad now, on the ground, and after the session.
    """
    if not status.is_in_flight:
        return ""
    headline = status.overall_judgement.headline
    is_bad_now = headline.is_bad and headline.code is not WatchFact.ALARM_OVER
    link_loss = _certain_link_loss(status)
    if not is_bad_now and link_loss is None:
        return ""
    next_step = status.overall_judgement.next_step
    sentences = render_section(
        "live_alarm",
        link_loss=link_loss,
        alarm=_reason_to_land(next_step),
        headline=headline,
        is_landing=next_step.figures.get("is_landing", False),
    )
    return " ".join(sentence.text for sentence in sentences)


def _certain_link_loss(status: SessionStatus) -> Fact | None:
    """Returns the fact that the link to a flying vehicle is lost, without what was wrong before; None if it is not.

    None also while messages from before the silence wait for their analysis: the vehicle may have landed in them.

    Args:
        status: state of the session.
    """
    link_loss = status.link_loss
    if link_loss is None or link_loss.figures["delay"] is not None:
        return None
    return link_loss.replace(cause=None)


def _reason_to_land(next_step: Fact) -> Fact | None:
    """Returns the fact (coded finding) on the vehicle for which it must land now.

    If its link was lost since, this is what was wrong before. None if it need not land now, or only since its link is
    lost.

    Args:
        next_step: what the pilot is to do next.
    """
    if next_step.code is not NextStep.LAND_NOW:
        return None
    reason = cause_of_alarm(next_step.figures["reason"])
    return None if reason.code is LinkFact.LOST_IN_FLIGHT else reason


def statement_of_headline(headline_text: str, headline_fact: Fact) -> str:
    """Returns the headline of a live flight, without the list of checked or watched parts if it states no alarm.

    The page shows the judgement of each part beside the headline.

    Args:
        headline_text: the headline in words.
        headline_fact: the fact (coded finding) that it states.
    """
    has_list_of_parts = headline_fact.code in HEADLINES_WITHOUT_ALARM
    return first_clause(headline_text) if has_list_of_parts else headline_text


def headline_and_next_step(judgement: Judgement) -> list[str]:
    """Returns the headline of a judgement as a line, and the next step as another one if the headline lacks it.

    Args:
        judgement: headline, next step and status lights of the vehicle in a live session.
    """
    headline_text = headline(judgement.headline)
    next_step = str(judgement.next_step)
    if next_step in headline_text:
        return [headline_text]
    return [headline_text, f"{NEXT_STEP_LEAD}{next_step}"]


def headline_reason(judgement: Judgement, *, are_details_stated: bool = False) -> list[Sentence]:
    """Returns the sentences below the headline of a live page: where a lost vehicle was, and why an alarm was raised.

    Args:
        judgement: headline, next step and status lights of the vehicle in a live session.
        are_details_stated: whether the page states the details of that fault elsewhere, such as in a list of events.

    Returns:
        - After a lost link in flight, the last known position.
        - If a fault of this flight is the reason for the headline, what shows the fault: measurements or, if nothing
          else states them, its details.

        Empty in other cases.
    """
    sentences: list[Sentence] = []
    if judgement.headline.code is LinkFact.LOST_IN_FLIGHT:
        sentences += render_section("live_last_seen", loss=judgement.headline.figures)
    fault = cause_of_alarm(judgement.headline)
    # An all-clear is amber where a fault of an earlier flight may not be repaired, which the next step says.
    is_fault = fault.is_watch_or_bad and fault.code not in HEADLINES_WITHOUT_ALARM
    if not is_fault or fault.code in FAULTS_SHOWN_ELSEWHERE:
        return sentences
    measurements = headline_evidence(fault, judgement.lights)
    if measurements:
        return [*sentences, *measurements]
    if are_details_stated:
        return sentences
    return [*sentences, *_details_as_reason(fault)]


def _details_as_reason(fault: Fact) -> list[Sentence]:
    """Returns the details of a fault as the reason for the headline of a live page.

    Args:
        fault: the fault that the headline states in short, a coded finding.

    Returns:
        A list with one sentence; empty if the headline has the most important detail already.
    """
    details = _details_of_fault(fault)
    headline_of_fault = without_full_stop(headline(fault)).lower()
    if details.lower().startswith(headline_of_fault):
        return []
    # Details are separated by semicolons, the most important one first.
    first_detail, _, _ = without_full_stop(details).partition(";")
    if first_detail.lower() in headline_of_fault:
        return []
    return [Sentence(details, lead="Why:")]


def _details_of_fault(fault: Fact) -> str:
    """Returns the part of a fault's sentence after the colon, such as "motor 2 works 12 % harder than the others.".

    Args:
        fault: the fault, a coded finding. If its sentence has no colon, the whole sentence is returned.
    """
    _, _, details = fault.sentence.partition(": ")
    if not details:
        return f"{as_clause(fault)}."
    if details.startswith("it ") and fault.subject:
        # The part before the colon, which is left out, says what "it" is.
        return f"{fault.subject} {details.removeprefix('it ')}"
    return details


def unrepaired_fault_beside_next_step(status: SessionStatus) -> str:
    """Returns what to say of a fault of an earlier flight below the headline and the next step of a session.

    Args:
        status: state of the session.

    Returns:
        The fault that nobody has stated to be repaired, with what to do about it; without that where the next step
        says so already. Empty if there is no such fault, or if the headline states it.
    """
    judgement = status.session_judgement
    fault = status.unrepaired_fault
    if fault is None or judgement.headline.code is SessionFact.UNREPAIRED_FAULT:
        return ""
    if states_unrepaired_fault(judgement.next_step):
        return fault.sentence
    return fault.sentence_and_remedy


def verdict_on_present_flight(status: SessionStatus) -> str:
    """Returns what was found in the latest flight, if the headline of the session is a fault of an earlier flight.

    Without it, a reader would take that fault for one of the latest flight. Two headlines are such faults:
    ``FLIGHT_VERDICT``, of an earlier flight of this session, and ``UNREPAIRED_FAULT``, of a flight before it.

    Args:
        status: state of the session.

    Returns:
        The sentence, such as "This flight: no alarm now." or, after several flights, "Flight 2: nothing wrong found.";
        empty before the first flight, and without such a fault.
    """
    code_of_headline = status.session_judgement.headline.code
    if code_of_headline is SessionFact.FLIGHT_VERDICT:
        flight = f"Flight {status.flight_number}"
    elif code_of_headline is SessionFact.UNREPAIRED_FAULT and status.flight_number > 0:
        flight = "This flight"
    else:
        return ""
    headline_of_flight = status.overall_judgement.headline
    statement = statement_of_headline(headline_of_flight.sentence, headline_of_flight)
    return f"{flight}: {as_clause(statement)}."


def states_unrepaired_fault(next_step: Fact) -> bool:
    """Returns whether a next step is what to do about a fault of an earlier flight that may not have been repaired.

    Args:
        next_step: what the pilot is to do next, such as to take off only if motor 3 was repaired.
    """
    return next_step.code in (NextStep.FLY_ON_IF_REPAIRED, NextStep.TAKE_OFF_IF_REPAIRED)


def statement_of_repair(unrepaired_fault: Fact) -> str:
    """Returns the statement by which a user ends the warning of a fault of an earlier flight, shown beside a button.

    For example: "Motor 3 was repaired or inspected after the flight of 2026-11-28 09:15 UTC". Only the fault of a
    single motor names the motor.

    Args:
        unrepaired_fault: the fact that the fault may not have been repaired; its ``reason`` is the fault itself.
    """
    [statement] = render_section("live_repair", fault=unrepaired_fault.figures["reason"])
    return statement.text


def closing_lines(status: SessionStatus) -> list[str]:
    """Returns the last lines that a session prints: what it found, and what to do next.

    After one flight these are the headline and the next step. After several, they are the verdict on each flight (its
    headline), the worst flight first, so that a fault of the first flight is not forgotten because the last one was
    sound; and last one next step (:func:`_next_step_of_session`). If the session ended in flight, see
    :func:`_closing_lines_in_flight`.

    Args:
        status: state of the session at its end.

    Returns:
        The lines, such as "Flight 1: motor 3 lost about 25 % of its thrust." and "Next: check motor 3.".
    """
    verdicts = status.verdicts_worst_first
    if len(verdicts) < 2:
        return headline_and_next_step(status.session_judgement)
    if _is_landing(status.session_judgement.next_step):
        return _closing_lines_in_flight(status)
    lines = [verdict.fact.sentence for verdict in verdicts]
    next_step = _next_step_of_session(verdicts, status)
    if next_step:
        lines.append(f"{NEXT_STEP_LEAD}{next_step}")
    return lines


def _next_step_of_session(verdicts: Sequence[FlightVerdict], status: SessionStatus) -> str:
    """Returns what to do after several flights: the step of the worst one, then those of others that forbid to fly.

    A lesser fault has its verdict alone, so that what is read last is what matters most.

    Args:
        verdicts: the verdicts on all flights, the worst first.
        status: state of the session at its end.

    Returns:
        The sentences, each once; empty if nothing is to be done, or if the verdicts say it.
    """
    texts: list[str] = []
    for verdict in verdicts:
        flight_headline = verdict.judgement.headline
        text = _next_step_text(verdict, status)
        is_stated = text in headline(flight_headline) or text in texts
        if not is_stated and (not texts or flight_headline.forbids_flight):
            texts.append(text)
    return " ".join(texts)


def _next_step_text(verdict: FlightVerdict, status: SessionStatus) -> str:
    """Returns the sentence on what to do about one of several flights of a session; empty if nothing is to be done.

    Args:
        verdict: the verdict on the flight.
        status: state of the session at its end.
    """
    unrepaired_fault = status.unrepaired_fault
    if unrepaired_fault is not None and unrepaired_fault.figures["reason"] == verdict.fact:
        # The fault may have been repaired since, of which this sentence speaks.
        return unrepaired_fault.remedy
    step = _next_step_if_current(verdict.judgement.next_step, verdict, status)
    return "" if step is None else step.sentence


def _closing_lines_in_flight(status: SessionStatus) -> list[str]:
    """Returns the last lines of a session that ended in flight, after several flights.

    They say that the session ended in flight; what to do next, first to land and then what each flight with a fault
    demands; and the verdict on each flight, the worst first.

    Args:
        status: state of the session at its end; its next step is to land.
    """
    verdict_lines = []
    steps_after_landing = []
    for verdict in status.verdicts_worst_first:
        verdict_lines.append(verdict.fact.sentence)
        step_after_landing = _step_after_landing(verdict.judgement.next_step)
        if step_after_landing is None:
            continue
        step = _next_step_if_current(step_after_landing, verdict, status)
        if step is not None:
            steps_after_landing.append(step)
    landing = status.session_judgement.next_step
    next_step = _with_steps_after_landing(landing, _joined_steps(steps_after_landing))
    return [
        # The verdicts, which follow, state all faults.
        status.end_in_flight(cause=None).sentence,
        f"{NEXT_STEP_LEAD}{next_step.sentence}",
        *verdict_lines,
    ]


def _joined_steps(steps: Sequence[Fact]) -> str:
    """Returns several next steps as one text, for example "Do not fly before … is repaired. Nor fly before …".

    A sentence that two flights share, since they had the same fault, is in the text once.

    Args:
        steps: what to do next, the most important first.
    """
    stated_sentences = set[str]()
    texts = []
    is_ban_stated = False
    for step in steps:
        sentence = step.sentence
        if sentence in stated_sentences:
            continue
        stated_sentences.add(sentence)
        reason = step.figures.get("reason")
        if is_ban_stated and isinstance(reason, Fact):
            # The sentence then begins with "Nor fly before" instead of "Do not fly before".
            step = step.replace(reason=reason.replace(is_added=True))
        texts.append(step.sentence)
        is_ban_stated = is_ban_stated or BAN in sentence
    return " ".join(texts)


def _next_step_if_current(
    next_step: Fact, verdict: FlightVerdict, status: SessionStatus
) -> Fact | None:
    """Returns the next step of one of several flights of a session, unless it is out of date at the end; then None.

    It is out of date if an earlier flight was sound, or if the step is to fly and the worst fault of the session
    forbids that. After a sound last flight there is nothing to do either if that fault forbids to fly.

    Args:
        next_step: the next step of the flight, or the part of it that follows the landing.
        verdict: the verdict on the flight.
        status: state of the session at its end.
    """
    must_not_fly = status.verdicts_worst_first[0].judgement.headline.forbids_flight
    has_fault = verdict.judgement.headline.is_watch_or_bad
    is_latest = verdict.number == status.flight_number
    if not has_fault and (must_not_fly or not is_latest):
        return None
    advises_flight = next_step.without_flight_advice.sentence != next_step.sentence
    return None if must_not_fly and advises_flight else next_step


def _is_landing(next_step: Fact) -> bool:
    """Returns whether a next step is to land, which something may follow; without a link nothing follows it.

    Args:
        next_step: what the pilot is to do next.
    """
    if next_step.code is NextStep.LAND_NOW:
        return _reason_to_land(next_step) is not None
    return next_step.code in (NextStep.LET_LAND, NextStep.LAND_BY_SIGHT)


def _step_after_landing(next_step: Fact) -> Fact | None:
    """Returns what to do after the landing, such as to check a motor; None if nothing is to be done or it is not known.

    Args:
        next_step: what to do next. If that is to land, the step after it is a figure of this fact. Otherwise the
            vehicle has landed, and the step itself is returned.
    """
    if not _is_landing(next_step):
        return next_step
    # The figure "reason" of an urgent landing is its alarm, and that of other advice to land the step on the ground.
    name_of_figure = "next_step" if next_step.code is NextStep.LAND_NOW else "reason"
    step_after_landing: Fact | None = next_step.figures.get(name_of_figure)
    return step_after_landing


def _with_steps_after_landing(landing: Fact, steps: str) -> Fact:
    """Returns the advice to land and then what to do on the ground: "Let it land. After landing: Check motor 3.".

    Args:
        landing: the advice to land (a coded finding). Whatever it says to do on the ground is replaced.
        steps: the sentences on what to do on the ground, for all flights of the session. If they are empty, an urgent
            landing keeps its own step on the ground, and other advice to land ends with the landing.
    """
    is_urgent = landing.code is NextStep.LAND_NOW
    if not is_urgent:
        # The figure "reason" of such advice is what to do on the ground; an empty one is not printed.
        return landing.replace(reason=steps)
    if not steps:
        return landing
    # The figure "reason" of an urgent landing is its alarm, so that the step on the ground is a figure of its own.
    return landing.replace(next_step=steps)


def moment_text(event: Event) -> str:
    """Returns when an event of a live session was reported, such as "14:03:07 · 182.4 s".

    It is the time of day and, if it is known, the time on the vehicle's clock, by which sentences state times. That
    clock begins again with each boot of the autopilot, so that boots after the first one are numbered.

    Args:
        event: the event, as the session reports it.
    """
    moment = time_of_day(event.reception)
    if not isfinite(event.clock):
        return moment
    boot_text = f"boot {event.boot + 1}, " if event.boot else ""
    return f"{moment} · {boot_text}{event.clock:.1f} s"


def without_basis_of_phase(fact: Fact) -> Fact:
    """Returns a fact that the vehicle left the ground or is on it, without the names of the messages that show it.

    Whoever watches a flight sees where the vehicle is, and need not know these names. Other facts (coded findings) stay
    as they are.

    Args:
        fact: what an event of a live session reports.
    """
    if fact.code in (ReportedEvent.OFF_GROUND, ReportedEvent.ON_GROUND):
        return fact.replace(basis=())
    return fact


def live_report(
    history: LiveHistory,
    status: SessionStatus,
    seconds_by_activity: Mapping[TimeUse, float],
    axis: str,
    learned_seconds: float = 0.0,
) -> Blocks:
    """Returns the report of a live flight in sentences and tables.

    It begins with the errors of the predictions, alarms of the motors and the state of the session. Tables of the
    errors and of the session's time follow, and sentences on the learned data and on the link.

    Args:
        history: predictions of the flight with their errors, and the intervals from which models were learned.
        status: state of the session at its end.
        seconds_by_activity: how long the session was learning, waiting on the ground and so on, s.
        axis: axis whose model was learned.
        learned_seconds: length of the data from which the last model was learned, s.
    """
    errors = history.errors()
    # The first sentence states the errors at one horizon only: the one nearest to ``REPORTED_HORIZON``.
    errors_at_reported_horizon = min(
        errors, key=lambda error: abs(error.seconds - REPORTED_HORIZON), default=None
    )
    first_paragraph, *other_paragraphs = render_section(
        "live_state",
        horizon_errors=errors_at_reported_horizon,
        axis=axis,
        status=status,
        false_alarms=FALSE_ALARMS,
    )
    blocks: Blocks = [first_paragraph]
    for alarm in status.motor_alarms:
        is_of_flight = alarm in status.motor_alarms_of_flight
        lead = "Motors:" if is_of_flight else "Motors, in an earlier flight:"
        blocks.append(Sentence(f"{as_clause(alarm.fact)}.", lead=lead))
    blocks += other_paragraphs
    if errors:
        blocks.append(_error_table(errors, axis))
    blocks += render_section(
        "live_learned",
        errors=errors,
        learned_intervals=history.learned_intervals,
        learned_seconds=learned_seconds,
    )
    blocks.append(_time_table(seconds_by_activity))
    blocks += render_section("live_link", status=status)
    return blocks


def _time_table(seconds_by_activity: Mapping[TimeUse, float]) -> Table:
    """Returns a table of what a live session spent its time on: learning, on the ground, without a link, and so on.

    Args:
        seconds_by_activity: duration of each activity, s. They are rounded to whole seconds, and an activity of 0 s has
            no row.

    Returns:
        The table, whose first header has the sum, as in "of 312 s".
    """
    whole_seconds = {activity: round(seconds) for activity, seconds in seconds_by_activity.items()}
    rows = []
    for activity in TimeUse:
        if whole_seconds[activity]:
            # All texts are made as sentences of facts (coded findings); that of this fact is the activity's name.
            name = capitalize_first(Fact(SessionFact.SECONDS_SPENT, kind=activity))
            rows.append([name, f"{whole_seconds[activity]} s"])
    return Table([f"of {sum(whole_seconds.values())} s", "time"], rows)


def _error_table(errors: Sequence[HorizonErrors], axis: str) -> Table:
    """Returns a table of the errors of predictions in flight: a row for each horizon, the time ahead.

    It has three columns for the angle and three for the rate: the RMSE in degrees or degrees/s, the baseline's RMSE,
    and the percentage of the measurements that lay within the 90 % band of the predictions.

    Args:
        errors: errors at each horizon: mean squares, rad² and rad²/s², and fractions within the band.
        axis: name of the axis, the first output.
    """
    header = ["RMSE of predictions"]
    rows = [[f"{error.seconds:.2g} s ahead"] for error in errors]
    units_by_output = {axis: display_unit("rad"), f"{axis} rate": display_unit("rad/s")}
    for output, (name, unit) in enumerate(units_by_output.items()):
        header += [name_with_unit(name, unit.name), "baseline", "in its 90 % band"]
        for row, error in zip(rows, errors, strict=True):
            rmse = unit.scale * sqrt(error.mse[output])
            baseline_rmse = unit.scale * sqrt(error.baseline_mse[output])
            percent_in_band = 100 * error.coverage[output]
            row += [f"{rmse:.2g}", f"{baseline_rmse:.2g}", f"{percent_in_band:.0f} %"]
    return Table(header, rows)
