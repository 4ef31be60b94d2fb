"""Page: a result as one HTML file that can be mailed, printed and read without a network or a script.

Each page is the blocks that the screen shows too, figures, and folded chapters, which :func:`document` lays out.
"""

from __future__ import annotations

import platform
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from importlib.resources import files
from math import nan
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jinja2 import Environment, PackageLoader
from markupsafe import Markup, escape

from mavdem.analysis import LogAnalysis
from mavdem.analysis.findings import Findings, findings_of
from mavdem.assessment import Assessment
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.margins import margins_of
from mavdem.condition.inventory import inventory
from mavdem.condition.loop.advice import Advice
from mavdem.condition.loop.loop import Loop
from mavdem.condition.wind_velocity import WindVelocity
from mavdem.dem import Learned
from mavdem.dem.order_choice import OrderChoice
from mavdem.evaluate.comparison import Comparison
from mavdem.facts import Fact
from mavdem.facts.assessment import Grade, Purpose
from mavdem.facts.event import Event
from mavdem.facts.session import Spent
from mavdem.flight import Flight
from mavdem.report.blocks import Block, Sentence, Table, warning
from mavdem.report.comparison import comparison_report, order_report
from mavdem.report.condition import air_blocks, log_blocks
from mavdem.report.header import FEW_POINTS, POINTS, Head
from mavdem.report.labels import Labels
from mavdem.report.loops import margin_tables, tune_blocks
from mavdem.report.numbers import listed, named, readable, rounded
from mavdem.report.palette import INK_ON_LIGHT
from mavdem.report.review import title_of
from mavdem.report.screen import (
    conclusion,
    detail_blocks,
    graded,
    motor_blocks,
    prediction_blocks,
    screen,
    title,
    torque_blocks,
    vehicle_blocks,
)
from mavdem.report.timeline import Timeline, live_timeline, timeline_of
from mavdem.report.truth import truth_blocks
from mavdem.report.words import section

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mavdem.live.history import LiveHistory, SessionStatus


class Picture(NamedTuple):
    """A figure, which ``draw`` makes, or raises ``ValueError`` with a reason.

    A ``large`` one takes two columns; one that is not ``printed`` is on the screen only.
    """

    title: str
    caption: str
    draw: Callable[[], Figure]
    large: bool = False
    printed: bool = True


class Chapter(NamedTuple):
    """A part of the page after its result; of a ``folded`` one only the title is shown until it is opened."""

    title: str
    blocks: Sequence[Block] = ()
    pictures: Sequence[Picture] = ()
    folded: bool = False


def document(
    title: str,
    subtitle: str,
    blocks: Sequence[Block],
    chapters: Sequence[Chapter] = (),
    back: tuple[str, str] | None = None,
    head: Head | None = None,
) -> str:
    """Returns the HTML of a page: its title and subtitle, the result in ``blocks``, then chapters.

    ``head`` has facts, key figures and the timeline of a flight, drawn by a script within the page: without one its
    still picture is there instead, and in print. ``back`` is the name and the relative address of the page that leads
    here. All text is escaped. What cannot be drawn says why in its place. The same arguments give the same bytes with
    the same versions of mavdem, matplotlib and Python.
    """
    drawn = [
        _drawn(chapter, number) for number, chapter in enumerate(chapters) if any(chapter[1:3])
    ]
    parts: dict[str, Any] = {
        "title": title,
        "subtitle": subtitle,
        "blocks": blocks,
        "chapters": drawn,
    }
    parts |= {"back": back, "head": head}
    if head is not None and (timeline := head.timeline) is not None:
        if not head.is_small:
            from mavdem.report.figures.series import still
            from mavdem.report.figures.style import svg

            parts["still"] = Markup(svg(still(timeline), "timeline"))
        parts["timeline"] = timeline.as_json(FEW_POINTS if head.is_small else POINTS)
    return environment().get_template("document.html").render(parts)


def environment() -> Environment:
    """Returns Jinja's environment for the templates beside this file; it escapes all text.

    The timeline is drawn by uPlot (MIT), whose script and style are in ``uplot``, and ``timeline.js``.
    """
    made = Environment(
        loader=PackageLoader("mavdem.report", ""),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals |= {
        "made_by": f"mavdem {version('mavdem')}, Python {platform.python_version()}",
        "ink": INK_ON_LIGHT,
    }
    made.tests["table"] = lambda block: isinstance(block, Table)
    made.filters["prose"] = _prose
    return made


def _drawn(chapter: Chapter, number: int) -> dict[str, Any]:
    """The chapter with its pictures as SVG; where one cannot be drawn, a sentence with the reason."""
    blocks = list(chapter.blocks)
    drawings = []
    for place, picture in enumerate(chapter.pictures):
        try:
            from mavdem.report.figures.style import svg

            drawn = svg(picture.draw(), f"figure-{number}-{place}")
            drawings.append((picture, Markup(drawn)))
        except ValueError as error:
            blocks.append(Sentence(f"{error}.", f"{picture.title}:"))
    return {
        "title": chapter.title,
        "blocks": blocks,
        "drawings": drawings,
        "folded": chapter.folded,
    }


def _prose(text: str) -> Markup:
    """Text with what stands between backquotes as code, and no line's end before a percent sign."""
    text = str(escape(re.sub(r"(?<=\d) ?%", "\N{NO-BREAK SPACE}%", text)))
    return Markup(text if text.count("`") % 2 else re.sub("`([^`]*)`", r"<code>\1</code>", text))


def log_page(
    heading: Sentence,
    assessment: Assessment,
    inventory: dict[str, Any] | None = None,
    back: tuple[str, str] | None = None,
) -> str:
    """Returns the HTML of one log, with models or without.

    Without the ``inventory`` (``mavdem.condition.inventory``) the page is small, with few pictures, for many flights.
    ``back`` is name and address of the page that leads here.
    """
    whole = inventory is not None
    analyses = assessment.analyses
    timeline = timeline_of(assessment)
    head = Head(
        assessment.headline.level,
        assessment.analysis,
        assessment.lights,
        timeline,
        is_small=not whole,
        events=[Event(nan if fact.time is None else fact.time, fact) for fact in assessment.events],
    )
    chapters = list[Chapter]()
    for number, (axis, analysis) in enumerate(analyses.items()):
        if number == 0:
            chapters += [_motors(analysis, whole), _wind(assessment, analysis, timeline, whole)]
        else:
            chapters.append(Chapter(axis.capitalize(), verdict_of(analysis)))
        if analysis.learned is not None:
            chapters += _model(axis, analysis, analysis.learned, whole)
    if whole and assessment.evidence is not None:
        chapters.append(_loops_of_axes(assessment.evidence))
    for axis, analysis in analyses.items():
        if analysis.learned is not None:
            chapters.append(_inside(axis, analysis, analysis.learned, whole))
    if inventory is not None:
        read = log_blocks(inventory)
        chapters.append(Chapter("What was read from the log, and repaired", read, folded=True))
    above, *_, following = conclusion(assessment.judgement)
    verdict = [above, following, *(block for one in analyses.values() for block in verdict_of(one))]
    subtitle = heading.text[:1].upper() + heading.text[1:]
    return document(heading.lead.rstrip(":"), subtitle, verdict, chapters, back, head)


def review_page(assessment: Assessment) -> str:
    """Returns the HTML of the page of an ``assessment``."""
    heading = title_of(assessment)
    analysis = assessment.analysis
    if analysis is None or assessment.evidence is None:
        return log_page(heading, assessment, inventory(assessment.log))
    telemetry = assessment.evidence.signals.telemetry
    place = telemetry.system, telemetry.component
    known = {place: (analysis.verdict, analysis.condition, analysis.identity)}
    held = inventory(assessment.log, analysis.verdict.axis, "{}:{}".format(*place), None, known)
    held["vehicles"][0] |= assessment.of_documents | {"model": analysis.model}
    return log_page(heading, assessment, held)


def verdict_of(analysis: LogAnalysis) -> list[Block]:
    """Returns why there is no model, or how sure it is."""
    found = analysis.findings
    blocks = list[Block]()
    if analysis.learned is None and analysis.reason is not None:
        blocks.append(Sentence(str(analysis.reason), "No model:"))
    return [*blocks, *graded(found), *map(warning, found.warnings)]


def _motors(analysis: LogAnalysis, whole: bool) -> Chapter:
    """What is known of each motor and, without a full model, of the vehicle's condition."""
    learned = analysis.learned
    blocks = motor_blocks(learned, analysis.vehicle.hover if analysis.tier.name == "a" else None)
    pictures = list[Picture]()
    if learned is not None:
        pictures = model_pictures(learned, analysis.findings, ["motors"] if whole else [], analysis)
    blocks += vehicle_blocks(analysis.vehicle, bool(analysis.findings.overrides))
    if learned is None or analysis.tier.name != "a":
        blocks += [
            *section("tier", **analysis.tier.as_dict()),
            *section("condition", analysis.condition),
        ]
    return Chapter("Motors", blocks, pictures)


def _wind(
    assessment: Assessment, analysis: LogAnalysis, timeline: Timeline | None, whole: bool
) -> Chapter:
    """The wind in m/s and as a torque, its rose, and the path that was flown."""
    learned = analysis.learned
    pictures = list[Picture]()
    wind = assessment.wind
    blocks = air_blocks(assessment)
    if wind is not None and wind.directed and wind.sized and whole:
        told = "How often the wind came from where, by its estimated speed."
        pictures.append(Picture("Wind rose", told, partial(_rose, wind)))
    if timeline is not None and timeline.position is not None:
        told = "Over ground, north up, from ● to ■; the purple arrow flies with the wind."
        pictures.append(Picture("Flown path", told, partial(_path, timeline, wind)))
    if learned is not None:
        blocks += torque_blocks(learned.wind_torque, learned.physical)
        pictures += model_pictures(
            learned, analysis.findings, ["disturbance"] if whole else [], analysis
        )
    blocks += [] if analysis.truth is None else truth_blocks(analysis.truth)
    return Chapter("Wind and path", blocks, pictures)


# matplotlib takes a second to load: what draws is imported when a picture is drawn.


def _rose(wind: WindVelocity) -> Figure:
    from mavdem.report.figures.flights import rose_of_wind

    return rose_of_wind(wind)


def _path(timeline: Timeline, wind: WindVelocity | None) -> Figure:
    from mavdem.report.figures.flights import flown_path

    return flown_path(timeline, wind)


def _loops(loop: Loop, after: Loop | None) -> Figure:
    from mavdem.report.figures.loops import loops

    return loops(loop, after)


def _error_ratios(comparison: Comparison, from_zero: bool) -> Figure:
    from mavdem.report.figures.flights import error_ratios

    return error_ratios(comparison, from_zero)


def _model(axis: str, analysis: LogAnalysis, learned: Learned, whole: bool) -> Iterator[Chapter]:
    """The response, prediction and residual tests of an axis."""
    labels = Labels.of(learned)
    draw = partial(model_pictures, learned, analysis.findings, analysis=analysis)
    if whole:
        yield Chapter(f"Response of {axis}", pictures=draw(["bode", "step"]))
    forecasts = draw(["forecast"], outputs=len(labels.output_names) if whole else 1)
    yield Chapter(f"Prediction of {axis}", prediction_blocks(labels, analysis.held_out), forecasts)
    if whole:
        yield Chapter(f"Residual tests of {axis}", pictures=draw(["residuals"]))


def _loops_of_axes(evidence: Evidence) -> Chapter:
    """The margins of all axes, or why they are not known, and a picture of the loops with the least."""
    blocks = list[Block]()
    for one in margins_of(evidence):
        facts = [one.loop] if isinstance(one.loop, Fact) else []
        blocks += [
            Sentence(str(fact.but(names=(one.axis,))), f"{one.axis.capitalize()}:")
            for fact in one.facts or facts
        ]
    known = {axis: loop for axis, loop in evidence.loops.items() if isinstance(loop, Loop)}
    if not known:
        return Chapter("Control loops", blocks)
    weakest = min(known.values(), key=lambda loop: loop.rate.phase_margin)
    drawn = loop_picture(weakest)._replace(printed=False)
    return Chapter("Control loops", [*blocks, *margin_tables(known)], [drawn])


def _inside(axis: str, analysis: LogAnalysis, learned: Learned, whole: bool) -> Chapter:
    """How a model was learned, folded."""
    blocks = detail_blocks(learned, analysis.findings)
    methods = ["learning"] if whole else []
    settings = (
        [[name, str(value)] for name, value in asdict(learned.settings).items()] if whole else []
    )
    blocks += [Table(["setting", "value"], settings, words=True)] if whole else []
    pictures = model_pictures(learned, analysis.findings, methods, analysis)
    return Chapter(f"The model of {axis}, and how it was learned", blocks, pictures, folded=True)


def flight_page(file: str, assessment: Assessment) -> str:
    """Returns the HTML of one flight of a fleet, the log ``file``, with a link to the fleet's page."""
    heading = Sentence(title_of(assessment).text, file)
    return log_page(heading, assessment, back=("Fleet", "../index.html"))


_TEXTS = tomllib.loads((files("mavdem.report") / "pictures.toml").read_text("utf-8"))
PICTURES = {method: (table["title"], table["caption"]) for method, table in _TEXTS.items()}
"""Title and caption by the method of ``learned.plot`` that draws it."""
PRINTED = "motors", "bode", "forecast"  # of these, so that a page prints on few sheets
# what motors' effect, damping and lag show; nothing where these are unknown
SYSTEM_PICTURES = "bode", "step"


def model_pictures(
    learned: Learned,
    found: Findings,
    methods: Iterable[str] = PICTURES,
    analysis: LogAnalysis | None = None,
    outputs: int = 1,
) -> list[Picture]:
    """Returns the pictures of a model; those of forecasts and of hovering motors need the ``analysis`` it is from.

    Forecasts are of so many ``outputs``. Responses are left out where control effectiveness is not identifiable by what
    was ``found``.
    """

    # ``learned.plot`` loads matplotlib, which takes its time.
    def draw(method: str, output: int) -> Any:
        options: dict[str, dict[str, Any]] = {"bode": {"model": "physical"}}
        if analysis is not None:
            options["forecast"] = {"held_out": analysis.held_out, "output": output}
            options["motors"] = {"hover": analysis.vehicle.hover}
        return getattr(learned.plot, method)(**options.get(method, {}))

    pictures = []
    names = Labels.of(learned).output_names
    unknown = found.grade(Purpose.CONTROL_EFFECTIVENESS) is Grade.NOT_IDENTIFIABLE
    for method in (one for one in methods if not (unknown and one in SYSTEM_PICTURES)):
        title, caption = PICTURES[method]
        for output, name in enumerate(names[:outputs] if method == "forecast" else names[:1]):
            words = f"Forecast windows as above, for {name}." if output else caption
            printed = method in PRINTED and not output
            picture = partial(draw, method, output)
            pictures.append(Picture(title.format(output=name), words, picture, printed=printed))
    return pictures


def loop_picture(loop: Loop, after: Loop | None = None) -> Picture:
    """Returns the picture of the loops of an axis, and of those with other gains."""
    said = "Gain, phase and sensitivity of the open loops, how far they stay from −1, and steps, with 90 % bands."
    return Picture("Rate and attitude loop", said, partial(_loops, loop, after))


def tune_page(name: str, found: Mapping[str, Advice | Fact]) -> str:
    """Returns the HTML of ``mavdem tune`` of the log ``name``, by axis."""
    known = {axis: advice for axis, advice in found.items() if isinstance(advice, Advice)}
    drawn = {
        axis: loop_picture(one.before, one.after if one.parameters else None)
        for axis, one in known.items()
    }
    chapters = [Chapter(f"Loops of {axis}", pictures=[picture]) for axis, picture in drawn.items()]
    said = "Margins of the loops, and gains to set. Nothing was sent to the vehicle."
    return document(name, said, tune_blocks(found), chapters)


def comparison_page(comparison: Comparison, from_zero: bool = False) -> str:
    """Returns the HTML of a comparison; ``from_zero``: forecasts start from state 0."""
    windows = Picture(
        "Errors in every window",
        "Each dot is one window, each bar the median of a method. Dots at an edge are beyond it.",
        partial(_error_ratios, comparison, from_zero),
    )
    blocks = comparison_report(comparison, from_zero)
    first = next(number for number, block in enumerate(blocks) if isinstance(block, Table))
    pictures = Chapter("Pictures", pictures=[windows])
    subtitle = f"Forecasts of the same windows of {listed(comparison.flights)}."
    rest = blocks[first:]
    return document(
        "DEM and other methods", subtitle, blocks[:first], [pictures, Chapter("All errors", rest)]
    )


def order_page(choice: OrderChoice, names: Sequence[str], known_inputs: bool = True) -> str:
    """Returns the HTML of a ``choice`` of the model order of flights of these ``names``; as :func:`order_report`."""
    subtitle = f"The number of states that {listed(names)} show{'s' * (len(names) == 1)}, by the free energy."
    return document("Model order", subtitle, order_report(choice, names, known_inputs))


def live_page(
    link: str,
    axis: str,
    history: LiveHistory,
    status: SessionStatus,
    account: Mapping[Spent, float],
    learned: Learned | None,
) -> str:
    """Returns the HTML of a live flight: ``history`` was collected in flight, the others are those at its end.

    ``account`` has seconds by what they were.
    """
    found = status.findings or findings_of(learned, alarms=status.alarms)
    judgement = status.judged
    seconds = 0.0 if learned is None else len(learned.record) * learned.dt
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import live_report

    report = live_report(history, status, account, axis, seconds)
    timeline = live_timeline(history, axis)
    head = Head(
        judgement.headline.level,
        None,
        judgement.lights,
        timeline,
        vehicle=status.vehicle or "",
        events=history.events,
    )
    above, *_, following = conclusion(judgement)
    blocks = [above, following]
    chapters = [Chapter(f"Prediction of {axis} in flight, and the link", report)]
    if learned is not None:
        draw = partial(model_pictures, learned, found)
        blocks += graded(found)
        chapters.insert(0, Chapter("Motors", motor_blocks(learned, None)))
        torque = torque_blocks(learned.wind_torque, learned.physical)
        chapters.append(Chapter(f"Response of {axis}", torque, draw(SYSTEM_PICTURES)))
    what = f"What {axis} did, learned and predicted while it flew."
    return document(f"Flight over {link}", what, blocks, chapters, head=head)


def notebook_html(blocks: Sequence[Block]) -> str:
    """Returns paragraphs and tables as HTML by themselves, all text escaped."""
    shown = environment().get_template("blocks.html").module.shown(blocks)  # type: ignore[attr-defined]
    return f"<div><style>.words {{ text-align: left; }}</style>{shown}</div>"


def flight_html(flight: Flight) -> str:
    """Returns, for notebooks, which flight it is, and a row a channel; in degrees."""
    rows = []
    for kind in ("input", "output", "setpoint"):
        names, units, values = (
            getattr(flight, f"{kind}{part}") for part in ("_names", "_units", "s")
        )
        for name, unit, column in zip(
            names, map(readable, units), () if values is None else values.T, strict=True
        ):
            finite = unit.scale * column[np.isfinite(column)]
            figures = (
                (finite.mean(), finite.std(), finite.min(), finite.max()) if len(finite) else ()
            )
            rows.append([named(name, unit.name), kind, *(rounded(figure, 3) for figure in figures)])
    header = ["channel", "is", "mean", "sd", "lowest", "highest"]
    return notebook_html(
        [title([flight]), Table(header, [row + ["-"] * (len(header) - len(row)) for row in rows])]
    )


def learned_html(learned: Learned) -> str:
    """Returns, for notebooks, the screen's report of what the model alone knows."""
    record = learned.record
    what = f"{len(learned.model.A)} states, from {len(record) * record.dt:.0f} s at {1 / record.dt:.0f} Hz."
    return notebook_html([Sentence(what, "Learned model:"), *screen(learned)])
