"""Templates: facts (a code with figures) as sentences, and sections of reports as paragraphs, by Jinja2 in TOML files.

No other module has prose about a flight. Two folders beside this module hold the templates:

- ``sentences/*.toml`` has a table for each code of a fact, with its ``sentence`` and, where there is something to do,
  its ``remedy``. A ``headline`` is a shorter sentence, ``step_in_flight`` the step to take at once in flight; without
  one it is to land now. A table with ``advises_flight`` advises to fly: that part is left out for a fact with the
  figure ``is_grounded``, whose vehicle must not fly. Further keys: ``forbids_flight`` (:func:`forbids_flight`) and
  ``names_margins`` (:func:`_begins_with_margins`).
- ``sections/*.toml`` has the paragraphs of a section, each with a ``text``, a ``lead`` or both.

A number that stands in a template is shown as it is, and a fact as its sentence without the full stop. Filters format
figures for people: shares as percent, lists as "a, b and c".
"""

import re
import tomllib
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib.resources import files
from math import ceil, degrees, inf, isfinite, tau
from operator import attrgetter
from shlex import quote
from time import localtime, strftime
from typing import Any, NamedTuple

from jinja2 import Environment, FunctionLoader, StrictUndefined, Template

from mavdem.containers import group_by
from mavdem.facts import Code, Fact
from mavdem.facts.assessment import NextStep
from mavdem.facts.loops import ADVISED_STREAM_RATE
from mavdem.facts.motors import LIKELY_PROBABILITY
from mavdem.facts.watch import WatchFact
from mavdem.facts.witnesses import HeightSource
from mavdem.files import load_adjacent_toml
from mavdem.report.blocks import Sentence
from mavdem.report.numbers import (
    abbreviated_list,
    counted,
    display_unit,
    listed,
    one_line_list,
    plus_minus,
    plus_minus_or_below,
    rounded,
    with_unit,
    without_remark,
)
from mavdem.report.template_cache import CompiledTemplates
from mavdem.wind_velocity.compass import compass_point, compass_text, compass_words

PARAMETERS = {
    "effect": "control effectiveness",
    "damping": "rate damping",
    "lag": "motor time constant",
}
"""The name shown for each physical parameter, by its name in ``Physical.status``."""


BAN = "Do not fly"
"""Beginning of sentences that forbid flight."""


def bans_first(steps: Iterable[str]) -> list[str]:
    """Returns texts on what to do next, with those that forbid flight before all others; otherwise in their order."""
    return sorted(steps, key=lambda step: BAN not in step)


class Medium(NamedTuple):
    """Where sentences are read, which decides how they name what to do."""

    has_terminal: bool = True
    """Whether the reader has a terminal: sentences for a browser name no commands."""

    has_gain_table: bool = False
    """Whether the gains to set stand beside the sentences, in a table."""

    table_gains: frozenset[str] = frozenset()
    """Names of the gains in that table that are to be loaded, and not only tried."""


TERMINAL = Medium()
"""What sentences are made for unless :func:`sentences_for` says otherwise."""

MEDIUM: ContextVar[Medium] = ContextVar("MEDIUM", default=TERMINAL)
"""Where the sentences that are rendered now will be read."""

MAX_DECIMALS_BELOW_LIMIT = 5
"""Decimals that :func:`rounded_below` tries at most, before it shows six significant digits."""

_IDENTIFIER = re.compile(r"\w+[A-Z_]")
"""A first word with a capital letter or an underscore after its first letter: an acronym, a class, a parameter."""

SMALLEST_SHOWN_HALF_WIDTH = 0.1
"""Half width, % or °, up to which it is left out beside an estimate: it is below the digits of the estimate."""

ROUNDS_TO_NO_PERCENT = 0.005
"""Share below which a text in whole percent says 0 %."""


SETPOINT_MESSAGES = {
    "DataFlash": "RATE and ATT (ArduCopter from 3.3 on)",
    "ULog": "vehicle_rates_setpoint",
    "": "ATTITUDE_TARGET",
}
"""Messages with setpoints of rate and attitude, by what recorded a log; telemetry has no recorder."""

BATTERY_MESSAGES = {
    "DataFlash": "BAT (CURR in old versions)",
    "ULog": "battery_status",
    "": "SYS_STATUS",
}
"""Messages with the voltage of the battery, by what recorded a log; telemetry has no recorder."""


@contextmanager
def sentences_for(medium: Medium) -> Iterator[None]:
    """Sets the medium, such as a page or the terminal, for all sentences that are rendered within its block.

    Sentences differ by medium: the terminal names a command where a page has a table. The setting is a context
    variable, so other threads are not affected.

    Args:
        medium: medium in which the sentences are shown.
    """
    token = MEDIUM.set(medium)
    try:
        yield
    finally:
        MEDIUM.reset(token)


def headline(fact: Fact) -> str:
    """Renders the short sentence about a fact that heads a report.

    A headline on a battery leaves out the other batteries, which the status light of the power lists.

    Args:
        fact: the fact, a coded finding.

    Returns:
        The sentence; the ordinary one of the fact where it has no short one.
    """
    has_further_batteries = bool(fact.figures.get("batteries"))
    if has_further_batteries:
        fact = fact.replace(batteries=())
    return _filled_template(fact, "headline") or sentence(fact)


def sentence(fact: Fact | str) -> str:
    """Renders the sentence of a ``fact``; text is returned unchanged, since some figures are already sentences."""
    if isinstance(fact, str):
        return fact
    return _filled_template(fact, "sentence")


def remedy(fact: Fact) -> str:
    """Renders the remedy of a ``fact`` (a coded finding), the advice on what to do.

    If the code of the fact has no template for a remedy, the figure ``remedy`` of the fact, which is itself a fact,
    takes its place. Without that the remedy is empty.
    """
    return _filled_template(fact, "remedy")


def render_section(name: str, record: object = None, /, **values: Any) -> list[Sentence]:
    """Fills the templates of a section of a report with values, and returns its paragraphs.

    The file ``sections/NAME.toml`` has two templates for each paragraph: its "text", and the "lead" before that, such
    as "Wind:". A paragraph may have one of them only. A paragraph whose text comes out empty has nothing to report in
    this case, and is left out, unless the file marks it by the key "always".

    Args:
        name: name of the section.
        record: an object whose public attributes the templates use by name, if any.
        **values: further values that the templates use by name.

    Returns:
        The paragraphs in the order of the file.
    """
    if record is not None:
        for attribute in dir(record):
            is_public = not attribute.startswith("_")
            if is_public:
                values[attribute] = getattr(record, attribute)
    sentences = []
    for templates in _section_templates(name):
        rendered = {key: template.render(values).strip() for key, template in templates.items()}
        text = rendered.get("text", "")
        has_only_lead = "text" not in rendered
        if text or has_only_lead or "always" in rendered:
            sentences.append(Sentence(text, rendered.get("lead", "")))
    return sentences


def sentences_by_axes(
    facts: Iterable[tuple[str, Fact]], text_of_fact: Callable[[Fact], str] = str
) -> list[Sentence]:
    """Renders facts (coded findings) about axes as sentences, in which axes with the same text share one.

    Two axes share a sentence, such as "Roll and pitch: …", if their texts are equal apart from the name of the axis,
    which holds if their rounded figures agree.

    Args:
        facts: pairs of an axis and a fact about it.
        text_of_fact: function that makes the text of a fact; by default its sentence.

    Returns:
        Sentences in the order in which their facts come first.
    """
    groups = group_by(facts, lambda axis_and_fact: text_of_fact(axis_and_fact[1].replace(axis="")))
    sentences = []
    for axes_and_facts in groups.values():
        axes = listed(axis for axis, _ in axes_and_facts)
        # One fact stands for the group, with the names of all its axes.
        _, first_fact = axes_and_facts[0]
        text = text_of_fact(first_fact.replace(axis=axes))
        sentences.append(Sentence(text, lead=f"{axes.capitalize()}:"))
    return sentences


def margins_in_short(rating: Fact) -> str:
    """Returns the stability margins of a control loop in few words, without intervals: "49°, 6.8 dB and Ms 2.2".

    Phase margin, gain margin and maximum sensitivity Ms follow each other. A loop that no gain makes unstable has no
    gain margin, which is then left out.

    Args:
        rating: the rating of the loop's margins (``Loops.MARGIN_RATING``), with the figures "phase_margin", degrees,
            "gain_margin", dB, and "ms".
    """
    figures = rating.figures
    margins = [f"{figures['phase_margin']:.0f}°"]
    if figures["gain_margin"] is not None:
        margins.append(f"{figures['gain_margin']:.1f} dB")
    margins.append(f"Ms {figures['ms']:.2g}")
    return listed(margins)


@cache
def sentence_templates() -> dict[str, dict[str, str]]:
    """Loads the templates of all facts (coded findings) from ``mavdem/report/sentences``.

    Returns:
        By the value of the fact's code, the templates by "sentence", "remedy" and so on.
    """
    templates = dict[str, dict[str, str]]()
    for path in (files("mavdem.report") / "sentences").iterdir():
        if path.name.endswith(".toml"):
            templates |= tomllib.loads(path.read_text("utf-8"))
    return templates


def _filled_template(fact: Fact, template_name: str) -> str:
    """Returns a text about a fact (a coded finding): one of the templates for its code, filled with its figures.

    The text depends on the medium in use (:func:`sentences_for`): for example, pages show gains in a table, and the
    terminal names a command.

    Args:
        fact: the fact. If it has the figure ``is_grounded``, the vehicle must not fly.
        template_name: "sentence", "remedy" (what to do), "headline" (a shorter sentence) or "step_in_flight".

    Returns:
        The text. It is empty if the code has no template of this name, or if the text would advise to fly a vehicle
        that must not fly.
    """
    must_not_fly = "is_grounded" in fact.figures
    if must_not_fly and _advises_flight(fact.code, template_name):
        return ""
    template = _fact_template(fact.code, template_name)
    text = template.render(_template_values(fact))
    return text.strip()


def _advises_flight(code: Code, template_name: str) -> bool:
    """Returns whether a text on a fact (a coded finding) advises to fly, for example to record more data.

    Such a text is not shown for a vehicle that must not fly.

    Args:
        code: code of the fact.
        template_name: which of its texts: "sentence" (what was found), "remedy" (what to do about it), or another.
    """
    # The TOML file of the texts has a table for each code: a template for each text, and the further key
    # ``advises_flight`` if one of them advises to fly.
    templates_of_code = sentence_templates()[code]
    if "advises_flight" not in templates_of_code:
        return False
    # Advice is in the remedy. A fact without one, such as a next step, is advice itself.
    advising_template = "remedy" if "remedy" in templates_of_code else "sentence"
    return template_name == advising_template


def _template_values(fact: Fact) -> dict[str, Any]:
    """Returns the values that the template of a fact's sentence may use, such as ``subject`` "motor 1", by name.

    They are the attributes and figures of the fact (a coded finding), and what the medium of the output, such as a
    terminal, can show. Jinja raises an error for a name without a value. Figures that only some facts have, and that
    templates of others test, therefore get a default here.

    Args:
        fact: the fact. If its figure ``is_grounded`` is true, the vehicle must not fly, and templates leave out advice
            to fly. If ``is_added`` is true, the sentence follows another one that says "Do not fly before …".
    """
    medium = MEDIUM.get()
    # The first words of advice not to fly: "Do not fly before motor 1 is inspected. Nor fly before …".
    ban = "Nor fly" if fact.figures.get("is_added") else BAN
    values = {
        "remedy": "",
        "action": None,
        "is_grounded": False,
        "is_added": False,
        "ban": ban,
        "has_terminal": medium.has_terminal,
        "has_gain_table": medium.has_gain_table,
        "table_gains": medium.table_gains,
        "level": fact.level,
        "time": fact.time,
        "end_time": fact.end_time,
        "subject": fact.subject,
    }
    # Figures come last, since they replace defaults of the same name.
    return values | dict(fact.figures)


@cache
def _fact_template(code: Code, template_name: str) -> Template:
    """Returns one of the compiled templates of a fact's code, such as its "sentence" or "remedy"."""
    return _compiled_template(f"sentences/{code}/{template_name}")


@cache
def _section_templates(name: str) -> list[dict[str, Template]]:
    """Returns the compiled templates of the paragraphs of a section, from the file ``sections/NAME.toml``.

    They are compiled once, since live pages render the same sections every few seconds.

    Args:
        name: name of the section, such as "why".

    Returns:
        For each paragraph its templates by their keys in the file: "text", "lead" and "always".
    """
    templates = []
    for paragraph_index, paragraph in enumerate(_section_paragraphs(name)):
        templates_of_paragraph = {}
        for template_name in paragraph:
            path = f"sections/{name}/{paragraph_index}/{template_name}"
            templates_of_paragraph[template_name] = _compiled_template(path)
        templates.append(templates_of_paragraph)
    return templates


def _compiled_template(path: str) -> Template:
    """Compiles a template by its path (:func:`_template_source`), or loads it if it was compiled before."""
    template = _environment().get_template(path)
    # Jinja gives each template a view of two dictionaries, which each rendering copies: a plain one is copied faster.
    template.globals = dict(template.globals)
    return template


@cache
def _section_paragraphs(name: str) -> list[dict[str, Any]]:
    """Loads a section of a report, ``sections/NAME.toml``: the templates of each paragraph by "text" and "lead"."""
    section = load_adjacent_toml(__file__, f"sections/{name}.toml")
    paragraphs: list[dict[str, Any]] = section["paragraph"]
    return paragraphs


def _template_source(path: str) -> str:
    """Returns the source of a template for Jinja, which asks for every template by a single string.

    Args:
        path: where the template stands in the TOML files:

            - "sections/SECTION/INDEX/NAME" for a paragraph of a report's section, such as "sections/wind/0/text" for
              the text of its first paragraph;
            - "sentences/CODE/NAME" for a fact (a coded finding), such as "sentences/motor_off/remedy".

    Returns:
        The source; empty if the fact's code has no template of this name.
    """
    if path.startswith("sections/"):
        _, section, paragraph_index, template_name = path.split("/")
        paragraph = _section_paragraphs(section)[int(paragraph_index)]
        return str(paragraph[template_name])
    _, code, template_name = path.split("/")
    templates = sentence_templates()[code]
    if template_name == "remedy" and "remedy" not in templates:
        # The remedy may instead be another fact, in the figure ``remedy``: its sentence says what to do.
        return "{{ remedy | string if remedy }}"
    return templates.get(template_name, "")


@cache
def _environment() -> Environment:
    """Returns the Jinja environment that compiles the templates of all sentences; it is made once.

    An undefined name is an error, so that a typing error in a template does not become an empty space in a report.
    Nothing is escaped, since the output is plain text; pages escape it later. ``globals`` are functions that templates
    call, and ``filters`` are those that they apply as in ``value | rounded``. To give templates a new one, it is enough
    to add it here by its name.
    """
    environment = Environment(
        loader=FunctionLoader(_template_source),
        bytecode_cache=CompiledTemplates(),
        undefined=StrictUndefined,
        finalize=_printed_value,
        autoescape=False,
    )
    environment.globals |= {
        "counted": counted,
        "inf": inf,
        "interval": interval,
        "likely_probability": LIKELY_PROBABILITY,
        "list_separator": list_separator,
        "mean_of_others": mean_of_others,
        "period": period,
        "tau": tau,
        "zip": zip,
    }
    environment.filters |= {
        "are_in": changes_are_in,
        "abbreviated_list": abbreviated_list,
        "sentence_and_remedy": attrgetter("sentence_and_remedy"),
        "after_landing": after_landing,
        "as_clause": as_clause,
        "baseline_flights": _baseline_flights,
        "earlier_fault_clause": _earlier_fault_clause,
        "further_clauses": _further_clauses,
        "capitalize_first": capitalize_first,
        "step_in_flight": _step_in_flight,
        "time_of_day": time_of_day,
        "land_now": _land_now,
        "compass_point": compass_point,
        "compass_text": compass_text,
        "compass_words": compass_words,
        "margins_in_short": margins_in_short,
        "logging_clause": _logging_clause,
        "model_share": model_share,
        "degrees": degrees,
        "first_sentence": first_sentence,
        "fixed": _fixed,
        "seconds_or_minutes": _seconds_or_minutes,
        "rounded_up": rounded_up,
        "forbids_flight": forbids_flight,
        "headline": headline,
        "headroom_clause": headroom_clause,
        "height_up": height_up,
        "by_source": by_source,
        "listed": listed,
        "one_line_list": one_line_list,
        "parameter": PARAMETERS.get,
        "percent": _percent,
        "plus_minus": plus_minus,
        "plus_minus_or_below": plus_minus_or_below,
        "probability": _probability,
        "quoted": quote,
        "reason_for_no_margins": _reason_for_no_margins,
        "recording_advice": _recording_advice,
        "rounded": rounded,
        "rounded_below": rounded_below,
        "sentence": sentence,
        "setpoint_messages": _setpoint_messages,
        "battery_messages": _battery_messages,
        "weak_motor_clause": _weak_motor_clause,
        "with_interval": with_interval,
        "against_mean": against_mean,
        "with_unit": _with_display_unit,
        "without_full_stop": without_full_stop,
        "without_remark": without_remark,
    }
    return environment


def _printed_value(value: Any) -> Any:
    """Returns what Jinja prints for a value that a template names, such as ``{{ reason }}``.

    A fact (a coded finding) is printed as its sentence without the full stop, since it stands inside another sentence.
    A text has its line breaks replaced by spaces: it may come from a log, and could otherwise print a line of its own.

    Args:
        value: value of the name in the template; one that is neither a fact nor a text is printed as it is.
    """
    if isinstance(value, Fact):
        return without_full_stop(value)
    if isinstance(value, str):
        return " ".join(value.splitlines())
    return value


def mean_of_others(mean_before: float, mean_after: float) -> str:
    """Returns the remark, in brackets, on how the other motors' mean command changed when one motor's command did.

    It ends a sentence about that one motor, as in " (the mean of the others from 45 % to 52 %)".

    Args:
        mean_before: mean command of the other motors before the change, as a fraction of the range.
        mean_after: the same after the change.
    """
    before_text = _percent(mean_before)
    after_text = _percent(mean_after)
    if before_text == after_text:
        return f" (the mean of the others stayed at {after_text})"
    return f" (the mean of the others from {before_text} to {after_text})"


def list_separator(loop: Any, is_continued: bool = False) -> str:
    """Returns the separator before an entry of a list in words, as in "a, b and c": "", ", " or " and ".

    Args:
        loop: the variable ``loop`` of a Jinja template at this entry, with the attributes ``first`` and ``last``.
        is_continued: whether the template adds another entry after the loop, before which it writes "and" itself.
    """
    if loop.first:
        return ""
    if loop.last and not is_continued:
        return " and "
    return ", "


def with_interval(value: float, half_width: float | None, unit: str = " %") -> str:
    """Formats an estimate with the half width of its interval, in percent or degrees, such as "12 ± 3 %".

    Args:
        value: the estimate: a fraction if the ``unit`` is " %", otherwise an angle, rad.
        half_width: half width of its interval, as a fraction or in rad too; None if it is not known. It is left out if
            it is at most 0.1 % or 0.1°, which is below the shown digits.
        unit: " %", or the unit that follows an angle in degrees.

    Returns:
        The text, with the unit.
    """
    # Factor from a fraction to percent, or from radians to degrees.
    scale = 100.0 if unit == " %" else degrees(1)
    shown_value = scale * value
    if half_width is not None and scale * half_width > SMALLEST_SHOWN_HALF_WIDTH:
        return f"{plus_minus(shown_value, scale * half_width)}{unit}"
    return f"{rounded(shown_value)}{unit}"


def against_mean(deviation: float, half_width: float | None) -> str:
    """Formats how much harder or less hard a motor works than the mean, such as "12 ± 3 % less hard than the mean".

    Args:
        deviation: the motor's output above the mean of all motors, as a fraction of that mean.
        half_width: half width of its interval, as a fraction; None if it is not known.
    """
    direction = "harder" if deviation > 0 else "less hard"
    return f"{with_interval(abs(deviation), half_width)} {direction} than the mean"


def _recording_advice(least_rate: float) -> str:
    """Returns the advice to record a flight fast enough for its control loops, at a least rate in Hz."""
    return f"Record attitude, rates and motor outputs at {_fixed(least_rate)} Hz or more."


def headroom_clause(headroom: float | None) -> str:
    """Returns a clause on how little of their command range the motors have left, such as "; only 3 % of headroom".

    Args:
        headroom: headroom up to the upper limit, as a fraction of the range; None if there is enough.

    Returns:
        The clause, which ends a sentence; empty if there is enough headroom.
    """
    if headroom is None:
        return ""
    if headroom < ROUNDS_TO_NO_PERCENT:
        return "; no headroom"
    return f"; only {_percent(headroom)} of headroom"


def rounded_below(value: float, limit: float) -> str:
    """Formats a value below a limit with so many decimals that the rounded text is below the limit, too.

    A sentence says that the value is too low. For example, 4.97 below 5 is "4.97", since "5.0" would contradict that.
    A single decimal that is 0 is left out.

    Args:
        value: the number, less than the limit.
        limit: the limit, in the same unit.

    Returns:
        The text, without a unit.
    """
    text = f"{value:.6g}"
    for decimals in range(1, MAX_DECIMALS_BELOW_LIMIT + 1):
        candidate = f"{value:z.{decimals}f}"
        if float(candidate) < limit:
            text = candidate
            break
    return text.removesuffix(".0")


def without_full_stop(fact: Fact | str) -> str:
    """Returns the sentence of a ``fact`` without its full stop, for use inside another sentence."""
    return str(fact).removesuffix(".")


def first_clause(text: str) -> str:
    """Returns the clause of a sentence that stands before its first colon, as a sentence of its own.

    >>> first_clause("Too little margin: roll has a phase margin of 20°.")
    'Too little margin.'

    Args:
        text: the sentence; one without a colon is returned whole.
    """
    clause, _, _ = text.partition(": ")
    return f"{without_full_stop(clause)}."


def first_sentence(text: str) -> str:
    """Returns the first sentence of a text; all of it where it has only one."""
    first, _ = first_and_further_sentences(text)
    return first


def first_and_further_sentences(text: str) -> tuple[str, str]:
    """Returns the first sentence of a text, and the text of those after it; that is empty after a single sentence."""
    first, separator, further = text.partition(". ")
    return f"{first}." if separator else text, further.strip()


def changes_are_in(changes: Iterable[Sequence[object]], names: Container[str]) -> bool:
    """Returns whether all gains that a fact changes are among some names: then a table shows them already.

    Args:
        changes: the changes; each begins with the name of the gain.
        names: the names, such as those in the table.
    """
    return all(str(change[0]) in names for change in changes)


def capitalize_first(text: object) -> str:
    """Returns ``text`` with a capital first letter, to begin a sentence; an identifier such as "gyroRate" stays."""
    sentence_text = str(text)
    if _IDENTIFIER.match(sentence_text):
        return sentence_text
    return sentence_text[:1].upper() + sentence_text[1:]


def period(time: float | None, end_time: float | None = None) -> str:
    """Returns when something happened, as text to follow a clause: " at 3.2 s" or " from 3.2 to 4.0 s".

    Args:
        time: the moment, or the start of the interval, s since boot; infinite if that was before the record. None if it
            is not known.
        end_time: end of the interval, s since boot; None for a moment, infinite if it lasted to the end of the record.

    Returns:
        The text with a space before it; empty if the time is not known.
    """
    if time is None:
        return ""
    if not isfinite(time):
        if end_time is None:
            return " before the record"
        if isfinite(end_time):
            return f" until {end_time:.1f} s"
        return " since before the record"
    start = f"{time:.1f}"
    # An interval whose rounded ends are equal is shown as a moment.
    if end_time is None or f"{end_time:.1f}" == start:
        return f" at {start} s"
    if isfinite(end_time):
        return f" from {start} to {end_time:.1f} s"
    return f" from {start} s on"


HEIGHT_SOURCE_WORDS = {
    HeightSource.BAROMETER: "the barometer",
    HeightSource.ESTIMATE: "the autopilot's estimate",
    HeightSource.SATELLITES: "satellites",
}
"""What measured a height or a descent, as words that follow "by"."""


def by_source(source: HeightSource | None) -> str:
    """Returns what measured a height or a descent, such as " by the barometer"; empty if that is not known."""
    return f" by {HEIGHT_SOURCE_WORDS[source]}" if source else ""


def height_up(
    height: float, source: HeightSource | None, satellite_height: float | None = None
) -> str:
    """Returns how high a vehicle was, such as "28 m up by the barometer, 12 m by satellites".

    Satellites may also place it below the take-off: "28 m up by the barometer, 2 m below the take-off by satellites".

    Args:
        height: height above the take-off, m.
        source: what measured it; None if that is not known.
        satellite_height: the height by satellites, m, if they contradict the source; None if they do not.
    """
    text = f"{_fixed(height)} m up{by_source(source)}"
    if satellite_height is not None:
        distance = _fixed(abs(satellite_height))
        place = " below the take-off" if satellite_height < 0 and distance != "0" else ""
        text += f", {distance} m{place} by satellites"
    return text


def interval(time: float, end_time: float | None = None) -> str:
    """Returns text to follow a clause that something lasted from a start to an end, such as " from 3.2 s to 4.0 s".

    Unlike :func:`period`, a missing end means the end of the record, and equal ends are both shown.

    Args:
        time: its start, s since boot; infinite if it started before the record.
        end_time: its end, s since boot; None if it lasted to the end of the record.

    Returns:
        The text with a space before it: " from 3.2 s" without an end, " until 4.0 s" without a start, and " throughout
        the record" without both.
    """
    if not isfinite(time):
        return " throughout the record" if end_time is None else period(time, end_time)
    if end_time is None:
        return f" from {time:.1f} s"
    return f" from {time:.1f} s to {end_time:.1f} s"


def as_clause(text: object) -> str:
    """Returns a sentence as a clause inside another one: with a small first letter and without its full stop.

    An acronym, a class or a parameter at its beginning ("GPS", "BrokenProcessPool", "MC_ROLL_P") stays as it is.

    Args:
        text: the sentence; it is converted to a string.
    """
    clause = without_full_stop(str(text))
    if _IDENTIFIER.match(clause):
        return clause
    return clause[:1].lower() + clause[1:]


def _earlier_fault_clause(fault: Fact) -> str:
    """Returns an earlier fault as a clause, such as "motor 3 failed" or "the battery was low (over since 84 s)".

    The sentence that a link was lost, or a session ended, contains it.

    Args:
        fault: the fault, or the end of its alarm, whose figure ``reason`` is the fault.
    """
    if fault.code is not WatchFact.ALARM_OVER:
        return as_clause(headline(fault))
    end = "over" if fault.time is None else f"over since {fault.time:.0f} s"
    return f"{as_clause(headline(fault.figures['reason']))} ({end})"


def _weak_motor_clause(weak_motor: Fact | None) -> str:
    """Returns a clause, for a sentence on a lost flight, about a motor that had lost thrust earlier in that flight.

    Args:
        weak_motor: the finding on the motor; None if no motor was weak.

    Returns:
        The clause, which ends the sentence; empty without a weak motor.
    """
    if weak_motor is None:
        return ""
    finding = as_clause(headline(weak_motor))
    return f"; before that, {finding}"


def _baseline_flights(count: int, are_chosen: bool) -> str:
    """Returns in words with which baseline of healthy flights a flight is compared, such as "6 healthy flights".

    Args:
        count: number of flights in the baseline.
        are_chosen: whether a user marked them as healthy. Otherwise they are the first flights of the vehicle, before
            its motors changed, in which it did not oscillate and no motor reached its limit. These need not be healthy,
            so that the text says that they are only taken for it.
    """
    if are_chosen:
        return counted(count, "healthy flight")
    if count == 1:
        return "the vehicle's one flight before, taken for healthy"
    return f"{count} of the vehicle's first flights, taken for healthy"


def forbids_flight(fact: Fact) -> bool:
    """Returns whether the remedy of a fact (coded finding), the advice that follows its sentence, says not to fly.

    A text with several facts then says so only once. In the file of sentence templates a code may have one of these
    rules under the key ``forbids_flight``; without a rule, its remedy does not forbid to fly.

    - "always".
    - "bad": if the level of the fact is bad.
    - "remedy": if the text of the remedy, which was stored with a log, says so.
    - "confirmed": if another sensor confirms the fact.
    - "reason": if the fact has another one as its figure "reason", whose remedy is its own too, and that forbids it.
    - "cause": likewise by the figure "cause". Without such a cause it has a remedy of its own, which forbids to fly.

    Args:
        fact: the fact, a finding with its code, level and figures.
    """
    rule = sentence_templates()[fact.code].get("forbids_flight", "never")
    if rule == "always":
        return True
    if rule == "bad":
        return fact.is_bad
    if rule == "remedy":
        return BAN in fact.remedy
    if rule == "confirmed":
        return "is_unconfirmed" not in fact.figures
    if rule in ("cause", "reason"):
        other_fact = fact.figures.get(rule)
        if isinstance(other_fact, Fact) and other_fact.remedy:
            return forbids_flight(other_fact)
        return rule == "cause"
    return False


def _reason_for_no_margins(reason: Fact, lead: str) -> str:
    """Returns the sentence that says why the stability margins of an axis are not known.

    Args:
        reason: the reason, a coded finding with its own sentence.
        lead: words that come before it, such as "No margins:"; they are left out if the sentence itself begins with the
            word "margins".
    """
    if _begins_with_margins(reason):
        return reason.sentence
    return f"{lead} {as_clause(reason)}."


def _begins_with_margins(fact: Fact) -> bool:
    """Returns whether the sentence of a fact (a coded finding) begins with the word "margins".

    If it does not, the caller puts the lead "No margins:" before it, so that no sentence has the word twice. The file
    of templates states for each code, under the key ``names_margins``, how its sentence begins:

    - "always": with the word. Without the key it begins with another one.
    - "reasons": like that of the first fact in the figure "reasons", or with the figure "names" if there is one.

    Args:
        fact: a reason why the margins of an axis are not known.
    """
    rule = sentence_templates()[fact.code].get("names_margins", "never")
    if rule == "reasons":
        if "names" in fact.figures:
            # These are names of loops, such as "The rate loop".
            return False
        first_reason = fact.figures["reasons"][0]
        return _begins_with_margins(first_reason)
    return rule == "always"


def _further_clauses(facts: Iterable[Fact]) -> str:
    """Returns facts as clauses at the end of the sentence of another fact, such as "; battery 1 down to 15.8 V".

    Args:
        facts: the further facts (coded findings), each with its own sentence.
    """
    clauses = [f"; {as_clause(fact)}" for fact in facts]
    return "".join(clauses)


def _step_in_flight(fact: Fact) -> str:
    """Returns what the pilot must do at once if a fact becomes known in flight.

    Args:
        fact: the fact, a coded finding such as an alarm.

    Returns:
        The text; empty if the templates of the fact have no such step. Then the pilot is to land.
    """
    return _filled_template(fact, "step_in_flight")


def after_landing(step: Fact | str) -> str:
    """Returns a sentence on what a pilot in flight has to do later, such as "After landing: Inspect motor 3.".

    Advice that needs a flight is for the next one: "In the next flight: Hover for 10 s or longer."

    Args:
        step: what to do, a fact or its sentence; a sentence counts as a step on the ground.
    """
    # The sentence of advice to fly becomes another one without that advice.
    needs_flight = isinstance(step, Fact) and step.without_flight_advice.sentence != step.sentence
    lead = "In the next flight" if needs_flight else "After landing"
    return f"{lead}: {without_full_stop(step)}."


def time_of_day(seconds: float) -> str:
    """Formats a UNIX time, s, as the time of day where this computer is: "12:31:05"."""
    return strftime("%H:%M:%S", localtime(seconds))


def _land_now(alarm: Fact) -> str:
    """Returns the sentence on what the pilot must do at once about the cause of an alarm in flight."""
    return Fact(NextStep.LAND_NOW, reason=alarm).sentence


def rounded_up(value: float, decimals: int = 0) -> str:
    """Formats an upper bound, rounded up, so that the text does not claim more than was found: 0.146 is "0.2".

    Args:
        value: the bound.
        decimals: number of decimals.

    Returns:
        The bound as text. It is below ``value`` by at most 10⁻⁶ of its last decimal.
    """
    scale = 10**decimals
    # The binary product of 0.3 and 10 may be a little more than 3 and become 4, so it is first rounded to a millionth.
    scaled_value = round(value * scale, 6)
    return _fixed(ceil(scaled_value) / scale, decimals)


def _seconds_or_minutes(duration: float) -> str:
    """Returns a duration in s such as "59 s", and from a minute on such as "1:05 min"."""
    minutes, seconds = divmod(round(duration), 60)
    return f"{minutes}:{seconds:02d} min" if minutes else f"{seconds} s"


def _fixed(value: float, decimals: int = 0) -> str:
    """Formats a number with so many decimals, and zero without a sign."""
    return f"{value:z.{decimals}f}"


def _percent(share: float, decimals: int = 0) -> str:
    """Formats a fraction as percent."""
    return f"{100 * share:.{decimals}f} %"


def model_share(share: float) -> str:
    """Formats the share of vehicle models that reach a goal, as percent or in words.

    The models are random draws that agree with a flight. Some hundred of them cannot show that none reaches the goal,
    so that 0 is "fewer than 0.5 %". Only 1 is "all"; 0.998 would be rounded to 100 % and is "over 99 %" instead.

    Args:
        share: the share, 0 to 1.
    """
    if share < ROUNDS_TO_NO_PERCENT:
        return "fewer than 0.5 %"
    if share >= 1:
        return "all"
    if share >= 1 - ROUNDS_TO_NO_PERCENT:
        return "over 99 %"
    return _percent(share)


def _logging_clause(rates: Sequence[float], names: Sequence[str]) -> str:
    """Returns the clause of advice to fly again that says how fast to log, and how fast this flight was logged.

    Args:
        rates: rates of the messages of this flight, Hz; empty if they are not known.
        names: names of the messages, as many.

    Returns:
        The clause, such as ", with rates and motors logged at 100 Hz (here RATE at 24 Hz and RCOU at 9.4 Hz)"; empty if
        all messages came that fast.
    """
    clause = ", with rates and motors logged at 100 Hz"
    if not rates:
        return clause
    if min(rates) >= ADVISED_STREAM_RATE:
        return ""
    messages = []
    for name, rate in zip(names, rates, strict=True):
        messages.append(f"{name} at {rounded(rate)} Hz")
    return f"{clause} (here {listed(messages)})"


def _setpoint_messages(recorder: str | None) -> str:
    """Returns the messages with setpoints, by what recorded the log: "DataFlash", "ULog", or "" for telemetry.

    Args:
        recorder: what recorded the log; of another recorder, and of none that is known (None), all messages are named.
    """
    if recorder in SETPOINT_MESSAGES:
        return SETPOINT_MESSAGES[recorder]
    return "RATE and ATT (ArduPilot), vehicle_rates_setpoint (PX4) or ATTITUDE_TARGET (telemetry)"


def _battery_messages(recorder: str | None) -> str:
    """Returns the messages with the voltage of the battery, by what recorded the log.

    Args:
        recorder: what recorded the log, "DataFlash", "ULog", or "" for telemetry; of another recorder, and of none that
            is known (None), the messages of all are named.
    """
    if recorder in BATTERY_MESSAGES:
        return BATTERY_MESSAGES[recorder]
    return "BAT (ArduPilot), battery_status (PX4) or SYS_STATUS (telemetry)"


def _probability(probability: float) -> str:
    """Formats a probability with two decimals; one that would be rounded to certainty is "> 0.99" or "< 0.01"."""
    if probability > 0.99:
        return "> 0.99"
    if probability < 0.01:
        return "< 0.01"
    return f"{probability:.2f}"


def _with_display_unit(value: float, unit: str) -> str:
    """Formats a value of the ``unit`` of a program, such as "rad/s", in the unit that people read."""
    return with_unit(value, display_unit(unit))
