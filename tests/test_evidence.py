"""The pages of docs/evidence: their tables are what commands printed, unchanged, and nothing contradicts them."""

import importlib.util
import os
import re
import shlex

import evidence
import propellers
from click import Group
from click.testing import CliRunner
from command_line import unknown_options
from pytest import approx, fixture, mark
from recorded_flights import shared

from mavdem.experiments.paper import CLAIMS

QUICK_COMMAND = "tools/validation/propellers.py ../shared/data/real/propeller"
"""A command of a page that takes a few seconds of a processor."""

LAST_DIGIT = {"abs": 0.011, "rel": 0.08}
"""Tolerances of its figures: another processor's rounding may change the last digit of 0.91 or 13 by one."""

TABLES_COPIED_BY_HAND = {
    # They compare reviews, readers and live sessions with earlier versions, of which a clone has no checkout.
    "forecasts.md": 3,
    "loops.md": 3,
    "motors.md": 1,
    "parameters.md": 1,
    # Its command takes minutes, and logs to copy.
    "serve.md": 1,
    # Most are of drafts whose commands are gone.
    "tried.md": 4,
    "wind.md": 1,
}
"""Largest number of tables outside of blocks by page, which no run of tools/evidence has printed yet."""

NUMBER = re.compile(r"\d+(?:\.\d+)?")


@fixture
def page(tmp_path, monkeypatch):
    """A page with two tables and the claims of one, beside its index."""
    page = tmp_path / "page.md"
    index = tmp_path / "index.md"
    page.write_text(
        "# Evidence: a page\n\n<!-- [[[cog claims() ]]] -->\n<!-- [[[end]]] -->\n\n"
        '<!-- [[[cog printed("echo **A:** Partly: 0.25") ]]] -->\n<!-- [[[end]]] -->\n'
    )
    index.write_text("# Index\n\n<!-- [[[cog pages() ]]] -->\n<!-- [[[end]]] -->\n")
    monkeypatch.setattr(evidence, "PAGES", [page, index])
    monkeypatch.setattr(evidence, "INDEX", index)
    assert evidence.write_tables("echo") == 0
    return page


def test_no_table_was_changed_by_hand_and_summaries_follow_from_their_pages():
    assert not evidence.is_inconsistent()


@mark.slow
def test_a_changed_figure_is_noticed(page):
    (table,) = evidence.measured_tables()
    assert (table.command, table.output) == (
        "echo **A:** Partly: 0.25",
        "**A:** Partly: 0.25",
    )
    assert not evidence.is_inconsistent()
    page.write_text(page.read_text().replace("0.25\n", "0.26\n"))
    assert evidence.is_inconsistent()
    assert evidence.write_tables("echo") != 0


def test_the_index_and_the_number_of_claims_follow_from_the_findings(page):
    line = "- [A page](page.md): Of 1 claims: 1 partly.\n"
    assert line in evidence.INDEX.read_text()
    page.write_text(page.read_text() + "\n**B:** Reproduced: it is so.\n")
    assert evidence.is_inconsistent()
    assert evidence.write_summaries() == 0
    assert "Of 2 claims: 1 reproduced, 1 partly.\n" in evidence.INDEX.read_text()
    assert not evidence.is_inconsistent()


def test_tables_stand_in_blocks():
    outside = {}
    for page in evidence.PAGES:
        text = evidence.written_by_hand(page.read_text())
        count = len(re.findall(r"^\|[-:| ]+\|$", text, re.MULTILINE))
        if count > TABLES_COPIED_BY_HAND.get(page.name, 0):
            outside[page.name] = count
    assert outside == {}


def test_figures_of_a_summary_stand_on_its_page():
    missing = {}
    for page in evidence.PAGES:
        text = page.read_text()
        summary = evidence.summary(page)
        if summary != evidence.claim_counts(text):
            figures = set(NUMBER.findall(text.replace(summary, "", 1)))
            missing[page.name] = set(NUMBER.findall(summary)) - figures
    assert not any(missing.values()), missing


def test_each_claim_has_its_findings_on_the_page():
    assert evidence.summary(evidence.INDEX.parent / "paper.md").startswith(
        f"Of {len(CLAIMS)} claims: "
    )


@mark.slow
def test_commands_of_the_tables_exist_with_their_options():
    """Each table of measurements names the command that made it: the command must have these options."""
    tables = evidence.measured_tables()
    assert QUICK_COMMAND in [table.command for table in tables]
    for table in tables:
        program, *words = shlex.split(table.command)
        if program == "mavdem":
            assert unknown_options(words) == set(), table.command
            continue
        # Another program is a script of this repository, which Click reads the options of, too.
        path = evidence.ROOT / program
        assert os.access(path, os.X_OK), table.command
        specification = importlib.util.spec_from_file_location(path.stem, path)
        script = importlib.util.module_from_spec(specification)
        specification.loader.exec_module(script)
        command = script.main
        if isinstance(command, Group):
            command = command.commands[words[0]]
        options = {option for parameter in command.params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= options, table.command


@mark.in_full
def test_a_table_is_printed_again():
    folder = shared("real/propeller")
    (table,) = [table for table in evidence.measured_tables() if table.command == QUICK_COMMAND]
    result = CliRunner().invoke(propellers.main, [str(folder)])
    printed = evidence.without_padding(result.stdout.strip())
    assert NUMBER.sub("", printed) == NUMBER.sub("", table.output)
    figures = [float(figure) for figure in NUMBER.findall(printed)]
    expected = [float(figure) for figure in NUMBER.findall(table.output)]
    assert figures == approx(expected, **LAST_DIGIT)
