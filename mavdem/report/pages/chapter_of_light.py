"""Which chapter of a page explains each status light (judgement of motors, power, …), and which are unfolded."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.lights import Light
from mavdem.facts.power import PowerLight
from mavdem.report.pages.hardware_chapters import HARDWARE_TITLE
from mavdem.report.pages.loop_chapters import TUNING_TITLE
from mavdem.report.pages.page import Chapter

INSTANCES_TITLE = "Batteries, sensors, estimators, outputs"
"""Title of the chapter of what a vehicle has several of."""

LOG_TITLE = "Log and repairs"
"""Title of the chapter of the log itself."""

CHAPTER_OF_LIGHT = {
    Light.MOTORS: "Motors",
    Light.VIBRATION: "Vibration",
    Light.TRACKING: "Three axes",
    Light.MARGINS: "Control loops",
    Light.POWER: INSTANCES_TITLE,
    Light.ESTIMATOR: INSTANCES_TITLE,
    Light.WIND: "Wind",
    Light.LOG: LOG_TITLE,
}
"""Title of the chapter with more about each light; a chapter is open where one of its lights is not good."""

SUPPLY_CODES = (PowerLight.SUPPLY_HELD, PowerLight.SUPPLY_LOW, PowerLight.SUPPLY_FELL)
"""Findings of the light of power that are about the supply of the autopilot's board, not about a battery."""

CHAPTER_LEVELS = (Level.BAD, Level.WATCH, Level.UNKNOWN, Level.GOOD)
"""Levels of a chapter from the worst to the best; one that is not known may hide a bad one."""


def unfold_chapters_of_warnings(
    chapters: Sequence[Chapter], lights: NamedFacts, headline: Fact
) -> Iterator[Chapter]:
    """Yields the chapters of a page with their levels; the bad ones are open, or else the one of a warning.

    A status light is the judgement of one part of the vehicle, such as its motors, with a level. The level of a chapter
    is the worst one of the lights that it explains. All other chapters are folded, so that the page is short.

    Args:
        chapters: the chapters.
        lights: the lights by name; each is a fact (a coded finding) with a level.
        headline: the fact in the headline, which is about a light or an event.
    """
    titles_to_open = _titles_to_open(chapters, lights, headline)
    for chapter in chapters:
        levels = _levels_of_chapter(chapter, lights)
        if levels:
            worst_level = min(levels, key=CHAPTER_LEVELS.index)
            chapter = chapter._replace(level=worst_level)
        is_open = chapter.title in titles_to_open
        yield chapter._replace(folded=not is_open)


def _titles_to_open(
    chapters: Sequence[Chapter], lights: NamedFacts, headline: Fact
) -> Collection[str]:
    """Returns the titles of the chapters that are open when a page is loaded; all others are folded.

    If something is bad, these are the chapters that show it. Otherwise they are the charts by which a pilot judges the
    tuning at a glance and, if there are warnings, one chapter with a warning: the one that the headline is about, or
    else the first. More would make the page long. The chapter on the log is not opened for a warning, since the
    sentence of its light says all that it shows.

    Args:
        chapters: the chapters, with the levels of their sections.
        lights: the judgement of each part of the vehicle by name, a fact (a coded finding) with a level.
        headline: the fact in the headline, which is about a light or an event.
    """
    bad_titles = _titles_with_level(chapters, lights, Level.BAD)
    if bad_titles:
        return bad_titles
    watched_titles = _titles_with_level(chapters, lights, Level.WATCH)
    if LOG_TITLE in watched_titles:
        watched_titles.remove(LOG_TITLE)
    for title in watched_titles:
        if _explains_headline(title, lights, headline):
            return [title, TUNING_TITLE]
    return [*watched_titles[:1], TUNING_TITLE]


def _titles_with_level(chapters: Sequence[Chapter], lights: NamedFacts, level: Level) -> list[str]:
    """Returns the titles of the chapters in which something has a certain level.

    Args:
        chapters: the chapters, with the levels of their sections.
        lights: the judgement of each part of the vehicle by name, a fact (a coded finding) with a level.
        level: the level, bad or to be watched.
    """
    return [chapter.title for chapter in chapters if level in _levels_of_chapter(chapter, lights)]


def _explains_headline(title: str, lights: NamedFacts, headline: Fact) -> bool:
    """Returns whether a chapter explains the headline of its page, as "Vibration" explains "Vibration is strong.".

    A chapter explains some of the status lights, each the judgement of one part of the vehicle. The headline may be the
    judgement of one of them, and then has its code.

    Args:
        title: title of the chapter.
        lights: the lights by name, each a fact (a coded finding) with a level.
        headline: the fact in the headline, which may also be an event.
    """
    codes_of_lights = [lights[name].code for name in lights_of_chapter(title, lights)]
    return headline.code in codes_of_lights


def title_of_headline(headline: Fact, lights: NamedFacts) -> str:
    """Returns the title of the chapter about the fault in the headline, such as "Motors"; empty without such a chapter.

    If the flight was lost, the chapter about the cause explains most, and best of all that about the cause of the
    cause. So causes come before the loss itself: the first that the light of a chapter states decides.

    Args:
        headline: the fact in the headline, a light or an event.
        lights: the judgement of each part of the vehicle by name, a fact (a coded finding) with a level.
    """
    first_cause_first = [headline.code]
    cause = headline.figures.get("cause")
    while isinstance(cause, Fact):
        first_cause_first.insert(0, cause.code)
        cause = cause.figures.get("cause")
    for code in first_cause_first:
        for name in CHAPTER_OF_LIGHT:
            if name in lights and lights[name].code is code:
                return chapter_of_light(name, lights[name])
    return ""


def chapter_of_light(light: Light, fact: Fact) -> str:
    """Returns the title of the chapter on a flight's page that explains a status light, such as "Vibration".

    A status light is the judgement of one subject. The judgement of the power may be about a battery, or about the
    supply of the autopilot's board, which are in different chapters.

    Args:
        light: name of the light, its subject.
        fact: the judgement, a coded finding. Its code tells a battery from the supply of the board.
    """
    is_about_supply_of_board = fact.code in SUPPLY_CODES
    if is_about_supply_of_board:
        return HARDWARE_TITLE
    return CHAPTER_OF_LIGHT[light]


def lights_of_chapter(title: str, lights: NamedFacts) -> list[Light]:
    """Returns the names of the status lights that a chapter of a page explains.

    A status light is the judgement of one part of the vehicle, such as its motors.

    Args:
        title: title of the chapter.
        lights: the lights of the flight by name, each a fact (a coded finding) with a level; some may be missing.
    """
    names = []
    for name in CHAPTER_OF_LIGHT:
        if name in lights and chapter_of_light(name, lights[name]) == title:
            names.append(name)
    return names


def _levels_of_chapter(chapter: Chapter, lights: NamedFacts) -> set[Level]:
    """Returns the levels, such as good or bad, of all judgements that a chapter of the page explains.

    These are the levels of status lights, each the judgement of one part of the vehicle such as its motors, and the
    chapter's own level, that of what has no light.

    Args:
        chapter: the chapter. If it has sections, ``chapter.level`` is the worst of their levels.
        lights: the lights by name, each a fact (coded finding) with a level.

    Returns:
        The levels; empty for a chapter that nothing judges.
    """
    levels = set()
    for light in lights_of_chapter(chapter.title, lights):
        levels.add(lights[light].level)
    if chapter.level is not None:
        levels.add(chapter.level)
    return levels


def anchors_of_lights(chapters: Sequence[Chapter], lights: NamedFacts) -> dict[str, str]:
    """Returns the anchor of the chapter about each light, as far as the page has it.

    Args:
        chapters: the chapters of the page.
        lights: the judgement of each part of the vehicle by name, a fact (a coded finding) with a level.
    """
    anchors = {}
    for chapter in chapters:
        if chapter.has_content:
            for light in lights_of_chapter(chapter.title, lights):
                anchors[str(light)] = chapter.anchor
    return anchors
