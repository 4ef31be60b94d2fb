"""Search in the library: a line such as ``quad-7 motors:bad wind>5 ATC_RAT_RLL_P>0.1`` is translated to SQL."""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.serve import Sharing, Stage
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from mavdem.report.numbers import listed
from mavdem.serve.compared_motors import (
    SHOWN_HEADLINE_OF_LOG_SQL,
    has_anomaly_sql,
    level_compared_with_fleet_sql,
    motors_level_sql,
)
from mavdem.serve.index import CONTENT_HASH_SQL, IS_VEHICLE_UNNAMED_SQL

MAX_SEARCH_WORDS = 20
"""Words of a search that are used; further ones are ignored, so that the SQL stays short."""

TERM_PATTERN = re.compile(r"(\w+)(<=|>=|[:=<>])(.+)")
"""A word of a search that compares a property: its name, the operator and the value."""

WORD_PATTERN = re.compile(r'(?:"[^"]*"?|[^\s"])+')
"""A word of a search; what stands between quotes, such as the name of a vehicle, may contain spaces."""

HALF_TYPED_TERM_PATTERN = re.compile(r"(\w+)(<=|>=|[:=<>]),*")
"""Such a word while its value is still to be typed, as ``motors:`` or ``motors:,``."""

TEXT_COLUMNS = {"level", "sharing", "stage", *map(str, Light)}
"""Columns that are compared as texts, by their own names."""

DATE_PATTERN = re.compile(
    r"\d{4}(-(0[1-9]|1[0-2])(-(0[1-9]|[12]\d|3[01])([ T]([01]\d|2[0-3])(:[0-5]\d)?)?)?)?",
    re.IGNORECASE | re.ASCII,
)
"""A date of a search: a year, month, day, hour or minute in UTC, as in ISO 8601.

The numbers are in the digits 0 to 9, since dates are compared as texts.
"""

WIND_LOW_SQL = "round(coalesce(wind_low, wind_speed), 1)"
"""SQL expression of the lower end of the wind speed's 90 % interval, m/s, rounded as the list shows it.

It is the speed itself for logs that an earlier version has read, which stored no interval.
"""

WIND_HIGH_SQL = "round(coalesce(wind_high, wind_speed), 1)"
"""SQL expression of the upper end of that interval, likewise."""

NUMBER_COLUMNS = {
    "wind": "wind_speed",
    "duration": "duration",
    "motor": "motor",
    "time": "flight_time",
    "distance": "distance",
    "height": "height",
}
"""SQL of what is compared as numbers, by the names that a search has for it.

Where a search compares the wind, its interval is used instead of this column.
"""

YAW_TRIM_GLOB = "yaw trim *"
"""Glob pattern of SQLite that the headline of a yaw trim matches, in small letters (``yaw_trim`` in motors.toml)."""

LEVEL_COLUMNS = {"level", *map(str, Light)}
"""Columns with a level, by their own names."""

CHOICES = {"stage": tuple(map(str, Stage)), "sharing": tuple(map(str, Sharing))}
"""Values that columns can have, by their own names; those of levels are not among them."""


LEVEL_SQL = level_compared_with_fleet_sql("level")
"""SQL expression of the level of the headline that pages show."""

MOTORS_LEVEL_SQL = motors_level_sql()
"""SQL expression of the level of the motors that pages show."""

COMPARED_LEVELS_SQL = {"level": LEVEL_SQL, str(Light.MOTORS): MOTORS_LEVEL_SQL}
"""SQL expressions of the levels that a comparison with other flights may make worse, by their names in a search."""

LEVELS = tuple(map(str, Level))
"""The levels."""

LIST_COLUMNS = {"mode": "modes", "tag": "tags"}
"""Columns with lists separated by commas, by the name that a search has for one item."""

KNOWN_TERMS = tuple(
    dict.fromkeys(
        ["vehicle", *LIST_COLUMNS, *NUMBER_COLUMNS, *Light, *sorted({"date", *TEXT_COLUMNS})]
    )
)
"""Names of the properties that a search compares, besides those of parameters."""

TERMS_OF_COMPLETE_ENTRIES = {"time", "distance", "height", "mode"}
"""Names of the properties, besides those of parameters, that ``mavdem track`` of earlier versions did not store."""

VEHICLE_NAME_SQL = (
    "coalesce((select vehicle_names.name from vehicle_names"
    " where vehicle_names.vehicle = entries.vehicle), '')"
)
"""SQL expression of the name that was given to the vehicle of an entry; empty without one."""

FLIGHT_NAME_SQL = (
    "coalesce((select flight_names.name from flight_names"
    f" where flight_names.content = {CONTENT_HASH_SQL}), '')"
)
"""SQL expression of the name that was given to the flight of an entry; empty without one."""

VEHICLE_KIND_SQL = (
    f"iif({IS_VEHICLE_UNNAMED_SQL} and {VEHICLE_NAME_SQL} = '',"
    " 'unnamed ', '') || autopilot || ' ' || replace(frame, '_', ' ')"
)
"""SQL expression of what an entry's vehicle is, such as "unnamed PX4 QUADROTOR"; only one without a name is unnamed."""

SIMULATED_SQL = "iif(simulated, 'simulated', '')"
"""SQL expression of the word with which the list of flights marks a simulated one; empty for another."""

SEARCHED_TEXT_SQL = " || ' ' || ".join(
    (
        "name",
        "vehicle",
        "date",
        SHOWN_HEADLINE_OF_LOG_SQL,
        "problem",
        "note",
        "tags",
        "modes",
        VEHICLE_NAME_SQL,
        FLIGHT_NAME_SQL,
        VEHICLE_KIND_SQL,
        SIMULATED_SQL,
    )
)
"""SQL expression of the text of an entry in which a plain word is searched for.

The sentence about an anomaly of the motors, which is the headline in the place of the log's own, is in another table.
"""

UNFINISHED_SQL = f"stage not in ('{Stage.DONE}', '{Stage.FAILED}')"
"""SQL condition of logs that are still to be read, or are being read."""


class SqlCondition(NamedTuple):
    """A condition of SQL on the table ``entries``."""

    expression: str
    """The expression after ``where``, with a ``?`` for each value."""
    values: tuple[Any, ...] = ()
    """The values, in order."""


def search_condition(text: str) -> SqlCondition:
    """Translates a search to SQL: an entry must match every word of it.

    Args:
        text: words separated by spaces. A word such as ``wind>5`` compares a property; any other word must occur in the
            texts of the entry, as must one that looks like a comparison of an unknown property. A comparison of a known
            one that has no value yet, such as ``motors:``, is left out.

    Returns:
        The condition on the table ``entries``; all entries meet the condition of an empty search.
    """
    # The first condition is always true, so that an empty search is a valid expression.
    conditions = [SqlCondition("1")]
    for word in _words(text):
        if _half_typed_name(word):
            # The search goes on while it is typed, and such a word does not limit it yet.
            continue
        term = _term(word)
        condition = None if term is None else _comparison_condition(term)
        if condition is None:
            condition = _word_condition(word)
        conditions.append(condition)
    # An expression may itself have an "or", and is put in brackets.
    expression = " and ".join(f"({condition.expression})" for condition in conditions)
    values: list[Any] = []
    for condition in conditions:
        values += condition.values
    return SqlCondition(expression, tuple(values))


def search_hints(text: str, *, is_nothing_found: bool) -> list[str]:
    """Returns hints on what may be wrong with a search, such as a value that is no number.

    Args:
        text: words of the search.
        is_nothing_found: whether no flight meets it. Only then are unknown properties among the hints, since such a
            word may also be a text that flights contain.

    Returns:
        A phrase on each, for the user.
    """
    hints = half_typed_terms(text) + search_problems(text)
    if is_nothing_found:
        hints += unknown_terms(text)
    return hints


def search_problems(text: str) -> list[str]:
    """Finds wrong values in a search, such as a word that compares a number, a level or a choice with something else.

    Args:
        text: words of the search.

    Returns:
        A phrase on each wrong value, for the user.
    """
    problems = []
    for term in _terms(text):
        problems += _problems_of_term(term)
    return problems


def half_typed_terms(text: str) -> list[str]:
    """Returns what the words of a search lack that compare a property, but have no value yet, such as ``motors:``.

    Args:
        text: words of the search.

    Returns:
        A phrase on each such word, for the user.
    """
    hints = []
    for word in _words(text):
        name = _half_typed_name(word)
        if not name:
            continue
        if name in CHOICES:
            hints.append(f"{word} lacks its value: these are {listed(CHOICES[name])}")
        elif name in NUMBER_COLUMNS:
            hints.append(f"{word} lacks its number")
        elif name in LEVEL_COLUMNS:
            hints.append(f"{word} lacks its level: these are {listed(LEVELS)}")
        else:
            hints.append(f"{word} lacks its value")
    return hints


def _words(text: str) -> list[str]:
    """Returns the words of a search, without their quotes: of ``vehicle:"Red quad"`` the one word ``vehicle:Red quad``.

    Args:
        text: the search; words after the first ``MAX_SEARCH_WORDS`` are left out.
    """
    words = [word.replace('"', "") for word in WORD_PATTERN.findall(text)]
    return [word for word in words if word][:MAX_SEARCH_WORDS]


def _half_typed_name(word: str) -> str:
    """Returns the property that a word of a search compares with a value that is not typed yet; empty otherwise."""
    match = HALF_TYPED_TERM_PATTERN.fullmatch(word)
    if match is None or match[1].lower() not in KNOWN_TERMS:
        return ""
    return match[1].lower()


def unknown_terms(text: str) -> list[str]:
    """Returns a hint about words of a search that compare a property which does not exist, such as ``colour:red``.

    Such a word may also be meant as a text that flights contain, such as the time of day 12:30, and is searched for as
    one. So the hint is shown only if the search finds nothing.

    Args:
        text: words of the search.

    Returns:
        A list with one sentence without its full stop; empty if all properties are known.
    """
    names = []
    for term in _terms(text):
        if term.name.lower() not in KNOWN_TERMS and not _is_parameter_name(term.name):
            names.append(term.name)
    if not names:
        return []
    shown_names = listed(dict.fromkeys(names))
    return [f"No such term: {shown_names}. Terms are {listed(KNOWN_TERMS)}, and gains"]


def needs_complete_entries(text: str) -> bool:
    """Returns whether a search compares what ``mavdem track`` of earlier versions did not store.

    These are the time in the air, distance, height, modes and gains. A flight that such a version has read is not found
    by them.

    Args:
        text: words of the search, such as "quad-7 height>50": some are terms that compare a property of the flights.
    """
    for term in _terms(text):
        is_gain = _is_parameter_name(term.name)
        if is_gain or term.name.lower() in TERMS_OF_COMPLETE_ENTRIES:
            return True
    return False


def _word_condition(word: str) -> SqlCondition:
    """Returns the SQL condition that a word is in the texts of a flight's entry, or in the sentence about its motors.

    That sentence says how the motors differ from those of the vehicle's other flights, if they do.

    Args:
        word: the word, as a user typed it.
    """
    is_in_entry = _contains(SEARCHED_TEXT_SQL, word)
    # The column "reason" of the table of such anomalies has the sentence.
    is_in_sentence = _contains("reason", word)
    has_anomaly_with_word = has_anomaly_sql(is_in_sentence.expression)
    return SqlCondition(
        f"({is_in_entry.expression})or({has_anomaly_with_word})",
        is_in_entry.values + is_in_sentence.values,
    )


class _Term(NamedTuple):
    """A word of a search that compares a property of the flights, such as ``wind>5``."""

    name: str
    """Name of the property: a column, or a parameter of the autopilot."""
    operator: str
    """``<``, ``>``, ``<=``, ``>=``, ``=`` or ``:``, which means ``=``."""
    value: str
    """The value that it is compared with."""


def _term(word: str) -> _Term | None:
    """Returns the comparison in a word of a search; None if the word is a plain text."""
    match = TERM_PATTERN.fullmatch(word)
    return None if match is None else _Term(*match.groups())


def _terms(text: str) -> Iterator[_Term]:
    """Yields the comparisons among the words of a search."""
    for word in _words(text):
        term = _term(word)
        if term is not None:
            yield term


def _problems_of_term(term: _Term) -> list[str]:
    """Returns a phrase on each wrong value in one comparison of a search, such as "soon is not a number".

    Args:
        term: the comparison: name of the property, operator and value.
    """
    name, operator, value = term
    column = name.lower()
    if column in CHOICES and value.lower() not in CHOICES[column]:
        # A property with a few possible values, such as the stage.
        return [f"{value} is no {column}: these are {listed(CHOICES[column])}"]
    if column in LEVEL_COLUMNS and operator in (":", "=") and not _is_number(value):
        # A light (the level of a part of the vehicle), such as motors:bad or motors:bad,watch.
        wrong_levels = [level for level in _typed_levels(value) if level.lower() not in LEVELS]
        return [f"{level} is no level: these are {listed(LEVELS)}" for level in wrong_levels]
    if column == "date" and not DATE_PATTERN.fullmatch(value):
        return [f"{value} is no date: write 2026-05-31, 2026-05 or 2026"]
    if _is_compared_as_number(name) and not _is_number(value):
        return [f"{value} is not a number"]
    if _is_parameter_name(name) and not CONTROL_PARAMETERS.match(name.upper()):
        return [
            f"{name} is not searched: of the parameters, only gains and filters of rate and attitude control are"
        ]
    return []


def _is_compared_as_number(name: str) -> bool:
    """Returns whether a search compares this property as a number, as it does parameters of the autopilot."""
    return name.lower() in {*NUMBER_COLUMNS, *LEVEL_COLUMNS} or _is_parameter_name(name)


def _is_parameter_name(name: str) -> bool:
    """Returns whether a name in a search names a parameter of the autopilot, such as "MC_ROLLRATE_P".

    Any name in capitals does, except those of other searchable properties (``KNOWN_TERMS``). A name in small letters
    does if it is that of a gain or filter of the controllers (``CONTROL_PARAMETERS``).
    """
    if name.lower() in KNOWN_TERMS:
        return False
    return name.isupper() or CONTROL_PARAMETERS.match(name.upper()) is not None


def _is_number(text: str) -> bool:
    """Returns whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _comparison_condition(term: _Term) -> SqlCondition | None:
    """Translates the comparison of one property in a search to SQL.

    The kinds of properties are tried in this order: lists, numbers, parameters, texts. Names of columns are taken from
    the tables of this module, and operators from the pattern of terms. Only values are the user's, and these are passed
    separately from the SQL.

    Args:
        term: the comparison: name of the property, operator and value.

    Returns:
        The condition; None if there is no such property, or the value is not a number although the property is one.
    """
    name, _, value = term
    column = name.lower()
    operator = term.operator.replace(":", "=")
    if column in LIST_COLUMNS:
        # Commas around the list and the item let only whole items match.
        return _contains(f"',' || {LIST_COLUMNS[column]} || ','", f",{value},")
    with suppress(ValueError):
        condition = _number_comparison(name, operator, float(value))
        if condition is not None:
            return condition
    if column == "vehicle":
        if term.operator == ":":
            # A part of the serial number or of the given name is enough.
            return _contains(f"vehicle || ' ' || {VEHICLE_NAME_SQL}", value)
        is_named = _text_comparison(column, operator)
        has_given_name = _text_comparison(VEHICLE_NAME_SQL, operator)
        return SqlCondition(f"(({is_named})or({has_given_name}))", (value, value))
    if column == "date":
        return _date_comparison(operator, value)
    if column in LEVEL_COLUMNS and operator == "=" and "," in value:
        return _level_condition(column, _typed_levels(value))
    if column in TEXT_COLUMNS:
        expression = COMPARED_LEVELS_SQL.get(column, column)
        return SqlCondition(_text_comparison(expression, operator), (value,))
    return None


def _number_comparison(name: str, operator: str, number: float) -> SqlCondition | None:
    """Translates the comparison of a property with a number to SQL; None if the property is no number.

    Args:
        name: the property: a column's name in a search, or an autopilot's parameter.
        operator: ``<``, ``>``, ``<=``, ``>=`` or ``=``.
        number: number to compare the property with.
    """
    column = name.lower()
    if column == "motor" and operator == "=":
        return _motor_condition(number)
    if column == Light.WIND:
        return _wind_comparison(operator, number)
    if column in NUMBER_COLUMNS:
        return SqlCondition(f"{NUMBER_COLUMNS[column]} {operator} ?", (number,))
    if _is_parameter_name(name):
        # Parameters are stored as a JSON object in the column ``gains``; a damaged one counts as empty. The name has
        # matched \w+, so it cannot contain the quote that would end the JSON path.
        gains = "iif(json_valid(gains),gains,'{}')"
        return SqlCondition(
            f"json_extract({gains}, ?) {operator} ?", (f'$."{name.upper()}"', number)
        )
    return None


def _motor_condition(number: float) -> SqlCondition:
    """Returns the SQL condition that a motor is suspected, by the log or by comparison with other flights.

    Args:
        number: number of the motor.
    """
    # A headline may name other motors besides the suspected one. That of a yaw trim names the motor that deviates most
    # and suspects none: all motors of one direction of rotation work harder.
    named_motor = f"*motor {number:g}[^0-9]*"
    headline = f"lower({SHOWN_HEADLINE_OF_LOG_SQL})"
    is_suspected_by_log = (
        f"(motor = ?) or ({headline} glob ? and {headline} not glob '{YAW_TRIM_GLOB}')"
    )
    is_suspected_by_comparison = has_anomaly_sql("suspect_motor = ? or lower(reason) glob ?")
    return SqlCondition(
        f"{is_suspected_by_log} or {is_suspected_by_comparison}",
        (number, named_motor, number, named_motor),
    )


def _wind_comparison(operator: str, speed: float) -> SqlCondition:
    """Translates the comparison of the wind speed, which is known as an interval, with a number to SQL.

    The wind is above a number if its whole interval is, below it likewise, and equal to it if the interval contains it.

    Args:
        operator: ``<``, ``>``, ``<=``, ``>=`` or ``=``.
        speed: the number, m/s.
    """
    if operator == "=":
        contains_speed = f"(({WIND_LOW_SQL} <= ?)and({WIND_HIGH_SQL} >= ?))"
        return SqlCondition(contains_speed, (speed, speed))
    if operator in (">", ">="):
        return SqlCondition(f"{WIND_LOW_SQL} {operator} ?", (speed,))
    return SqlCondition(f"{WIND_HIGH_SQL} {operator} ?", (speed,))


def _date_comparison(operator: str, value: str) -> SqlCondition | None:
    """Translates the comparison of the flight's date with a year, month, day, hour or minute to SQL.

    Each of these is an interval: ``date<=2026-05`` includes May, ``date>2026-05`` begins in June, and ``date=2026-05``
    is all of May. So the date of the flight is shortened to the length of the value, and both are compared as texts.
    The page of a fleet follows this rule, too (``fleet.html``).

    Args:
        operator: ``<``, ``>``, ``<=``, ``>=`` or ``=``.
        value: year, month, day, hour or minute in ISO 8601, such as "2026-05" or "2026-05-31T14".

    Returns:
        The condition; None if the value is no date.
    """
    if not DATE_PATTERN.fullmatch(value):
        return None
    shortened_date = f"substr(date, 1, {len(value)})"
    # Dates are stored with a T before the time of day.
    return SqlCondition(_text_comparison(shortened_date, operator), (value.replace(" ", "T"),))


def _typed_levels(value: str) -> list[str]:
    """Returns the different levels in a value such as "bad,watch", in their order.

    A comma after which no level is typed yet, as in "bad,", adds none.
    """
    levels = dict.fromkeys(value.split(","))
    return [level for level in levels if level]


def _level_condition(column: str, levels: Sequence[str]) -> SqlCondition:
    """Returns the SQL condition that a light (the level of a part of the vehicle) has one of some levels.

    Args:
        column: column of the light, such as "motors".
        levels: the levels as typed, in any case, such as "bad" and "watch".
    """
    expression = COMPARED_LEVELS_SQL.get(column, column)
    is_level = _text_comparison(expression, "=")
    return SqlCondition("or".join(f"({is_level})" for _ in levels), tuple(levels))


def _text_comparison(expression: str, operator: str) -> str:
    """Returns the SQL that compares a text with a value regardless of case; it holds for no entry without the text."""
    # An empty text is less than every other one, but NULL is neither less nor more.
    return f"nullif({expression},'') {operator} ? collate nocase"


def _contains(expression: str, text: str) -> SqlCondition:
    """Returns the condition that the text of an SQL expression contains ``text``, regardless of case."""
    # LIKE has wildcards, which a backslash makes plain characters.
    escaped_text = re.sub(r"([\\%_])", r"\\\1", text)
    return SqlCondition(f"{expression} like ? escape '\\'", (f"%{escaped_text}%",))
