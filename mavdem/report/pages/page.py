"""Page: a result as one HTML file that can be mailed, printed and read without a network.

Each page is the blocks that the screen shows too, charts, and folded chapters, which :func:`document` lays out.
"""

import platform
import re
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, Template
from markupsafe import Markup, escape

from mavdem.assessment.axis import LogAnalysis
from mavdem.assessment.axis.tuning import Tuning
from mavdem.dem import Learned
from mavdem.facts import Level, NamedFacts
from mavdem.facts.event import Event
from mavdem.flight import Flight
from mavdem.loops.advice import Advice
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.charts.chart import MAX_POINTS, Chart, Group
from mavdem.report.charts.flight_charts import loop_charts
from mavdem.report.charts.timeline import Timeline
from mavdem.report.loops import compared_loops, tune_blocks
from mavdem.report.numbers import display_unit, name_with_unit, rounded
from mavdem.report.palette import DISTURBANCE, INK_ON_LIGHT, PREDICTED
from mavdem.report.screen import conclusion, flight_title, model_screen

_UNSEEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""Control characters and marks that turn text around: a file's name may hold them."""


class Chapter(NamedTuple):
    """A part of the page after its result; of a ``folded`` one only the title is shown until it is opened."""

    title: str
    blocks: Sequence[Block] = ()
    groups: Sequence[Group] = ()
    folded: bool = False
    beside: bool = False
    """Whether its pictures stand beside its words."""


class Head(NamedTuple):
    """The top of a flight's page: how bad it is, the lights, what happened, and of which vehicle."""

    level: Level
    lights: NamedFacts
    events: Sequence[Event] = ()
    timeline: Timeline | None = None
    analysis: LogAnalysis | None = None
    vehicle: str = ""


def render_document(
    title: str,
    subtitle: str,
    blocks: Sequence[Block],
    chapters: Sequence[Chapter] = (),
    back: tuple[str, str] | None = None,
    head: Head | None = None,
    points: int = MAX_POINTS,
) -> str:
    """Returns the HTML of a page: its title and subtitle, the result in ``blocks``, then chapters.

    ``back`` is the name and the relative address of the page that leads here; lines have at most so many ``points``.
    All text is escaped. The same arguments give the same bytes with the same versions of mavdem and Python.
    """
    shown = [chapter for chapter in chapters if chapter.blocks or chapter.groups]
    return render_page(
        environment().get_template("document.html"),
        title=title,
        subtitle=subtitle,
        blocks=blocks,
        chapters=shown,
        back=back,
        head=head,
        points=points,
        has_charts=head is not None or any(chapter.groups for chapter in shown),
    )


def render_page(template: Template, **values: Any) -> str:
    """Returns the HTML that a ``template`` makes of ``values``, in which nothing turns text around."""
    return _UNSEEN.sub("\N{REPLACEMENT CHARACTER}", template.render(values))


@cache
def environment() -> Environment:
    """Returns Jinja's environment for the templates beside this file; it escapes all text.

    Charts are drawn by uPlot (MIT), whose script and style are in ``uplot``, and ``charts.js``.
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
        "disturbance": DISTURBANCE,
        "predicted": PREDICTED,
    }
    made.tests["table"] = lambda block: isinstance(block, Table)
    made.tests["chart"] = lambda panel: isinstance(panel, Chart)
    made.filters["prose"] = _prose
    return made


def _prose(text: str) -> Markup:
    """Text with what stands between backquotes as code, and no line's end before a percent sign."""
    text = str(escape(re.sub(r"(?<=\d) ?%", "\N{NO-BREAK SPACE}%", text)))
    return Markup(text if text.count("`") % 2 else re.sub("`([^`]*)`", r"<code>\1</code>", text))


def tune_page(name: str, tuning: Tuning) -> str:
    """Returns the HTML of ``mavdem tune`` of the log ``name``, by axis."""
    said = "Gain, phase and sensitivity of the open loops, with 90 % bands; dashed, where the gain is 1."
    chapters = []
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Advice):
            loops = compared_loops(advice)
            columns = (loop_charts(loops, "rate"), loop_charts(loops, "attitude"))
            chapters.append(Chapter(f"Loops of {axis}", (), [Group(columns, said)]))
    subtitle = "Margins of the loops, and gains to set. Nothing was sent to the vehicle."
    judgement = tuning.judgement
    above, *_, following = conclusion(judgement)
    head = Head(judgement.headline.level, judgement.lights)
    chapters.insert(0, Chapter("Margins and gains", tune_blocks(tuning)))
    return render_document(name, subtitle, [above, following], chapters, head=head)


def notebook_html(blocks: Sequence[Block]) -> str:
    """Returns paragraphs and tables as HTML by themselves, all text escaped."""
    shown = environment().get_template("blocks.html").module.shown(blocks)  # type: ignore[attr-defined]
    return f"<div><style>.words {{ text-align: left; }}</style>{shown}</div>"


def flight_html(flight: Flight) -> str:
    """Returns, for notebooks, which flight it is, and a row a channel; in degrees."""
    channels = (
        *zip(flight.input_names, flight.input_units, flight.inputs.T, strict=True),
        *zip(flight.output_names, flight.output_units, flight.outputs.T, strict=True),
    )
    rows = []
    for name, unit, column in channels:
        shown = display_unit(unit)
        figures = column.mean(), column.std(), column.min(), column.max()
        rows.append(
            [
                name_with_unit(name, shown.name),
                *(rounded(shown.scale * figure, 3) for figure in figures),
            ]
        )
    return notebook_html(
        [flight_title([flight]), Table(["channel", "mean", "sd", "lowest", "highest"], rows)]
    )


def learned_html(learned: Learned) -> str:
    """Returns, for notebooks, the screen's report of what the model alone knows."""
    record = learned.record
    sentence = f"{len(learned.model.A)} states, from {len(record) * record.dt:.0f} s at {1 / record.dt:.0f} Hz."
    return notebook_html([Sentence(sentence, "Learned model:"), *model_screen(learned)])
