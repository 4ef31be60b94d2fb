"""Chapters of a flight's page on hardware and commands: a section for each fact (a coded finding) and its charts."""

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.hardware import hardware_facts
from mavdem.assessment.hardware.calibration import sensors_in_parameters
from mavdem.assessment.hardware.commands import command_facts
from mavdem.facts import Level, NamedFacts
from mavdem.facts.hardware import HardwarePart
from mavdem.report.blocks import Blocks, Table
from mavdem.report.charts.chart import Group
from mavdem.report.charts.hardware_charts import hardware_groups
from mavdem.report.charts.timeline import Timeline
from mavdem.report.pages.page import Chapter, Section
from mavdem.report.templates import capitalize_first

HARDWARE_TITLE = "Hardware"
"""Title of the chapter on the hardware."""

COMMANDS_TITLE = "Setpoints and sticks"
"""Title of the chapter on what commanded the vehicle."""


def hardware_chapters(
    evidence: Evidence, lights: NamedFacts, timeline: Timeline | None
) -> list[Chapter]:
    """Returns two folded chapters of a flight's page: on the hardware, and on the setpoints and the pilot's sticks.

    A chapter has a section for each subject with logged data, such as the power supply: a sentence and charts.

    Args:
        evidence: signals, events and measurements of the vehicle.
        lights: status lights by name, each the judgement of one subject. That of the power is the sentence of the
            section on the power supply.
        timeline: charts of the flight over time, whose time range the charts of the sections share; None if there are
            none, and then the sections have no charts either.

    Returns:
        The chapters that have at least one section.
    """
    charts_by_subject: dict[str, list[Group]] = {}
    if timeline is not None:
        charts_by_subject = hardware_groups(evidence, timeline)
    tables_by_subject: dict[str, Blocks] = {}
    sensor_table = _sensor_table(evidence)
    if sensor_table.rows:
        tables_by_subject[HardwarePart.CALIBRATION] = [sensor_table]
    hardware_chapter = _chapter_of_facts(
        HARDWARE_TITLE, hardware_facts(evidence, lights), charts_by_subject, tables_by_subject
    )
    # The chapter on commands has no tables.
    command_chapter = _chapter_of_facts(
        COMMANDS_TITLE, command_facts(evidence), charts_by_subject, tables={}
    )
    return [chapter for chapter in (hardware_chapter, command_chapter) if chapter.sections]


def _chapter_of_facts(
    title: str, facts: NamedFacts, charts: dict[str, list[Group]], tables: dict[str, Blocks]
) -> Chapter:
    """Returns a folded chapter with a section for each subject, such as the power supply.

    A section has the sentence of a fact (a coded finding with a level), and the charts and tables of its subject.

    Args:
        title: heading of the chapter.
        facts: facts by subject.
        charts: groups of charts by subject; a subject may have none.
        tables: tables by subject; a subject may have none.

    Returns:
        The chapter, with the worst level of its facts; without a level if none of them is judged.
    """
    sections = []
    for subject, fact in facts.items():
        heading = capitalize_first(subject)
        sections.append(Section(heading, fact, charts.get(subject, ()), tables.get(subject, ())))
    levels = {fact.level for fact in facts.values()}
    worst_level = None
    for level in (Level.BAD, Level.WATCH, Level.GOOD):
        if level in levels:
            worst_level = level
            break
    return Chapter(title, level=worst_level, folded=True, sections=sections)


def _sensor_table(evidence: Evidence) -> Table:
    """Returns the sensors that the parameters name: the bus, whether each is used, and whether it is calibrated.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    rows = []
    for sensor in sensors_in_parameters(evidence.signals.telemetry):
        rows.append(
            [
                sensor.name,
                sensor.bus,
                "yes" if sensor.is_used else "no",
                "yes" if sensor.is_calibrated else "no",
            ]
        )
    return Table(["sensor", "bus", "used", "calibrated"], rows, words=True)
