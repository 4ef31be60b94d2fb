"""Lines at the end of a live session: which files it has written, what opens each, and why there are no gains."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote

from mavdem.facts import Fact, Facts
from mavdem.facts.loops import GainFact
from mavdem.facts.session import TimeUse
from mavdem.live.gain_advice import decisive_reason
from mavdem.report.templates import as_clause, first_sentence


def written_file_lines(
    *,
    record: Path | None,
    frame_count: int,
    rrd: Path | None,
    page: Path | None,
    model: Path | None,
) -> list[str]:
    """Returns a line for each file that a session has written: what it is, where, and what opens it.

    Args:
        record: recording of the raw stream; None for none, as for the other files.
        frame_count: messages in it.
        rrd: recording of the dashboard.
        page: page of what happened.
        model: learned model.
    """
    lines = []
    if record is not None:
        count = f"{frame_count:,} messages"
        lines.append(f"Recording: {record}, {count}. Judge it: `mavdem {_shell_word(record)}`")
    if rrd is not None:
        lines.append(f"Dashboard: {rrd}. Open it: `rerun {_shell_word(rrd)}`")
    if page is not None:
        lines.append(f"Page: {page}. Open it in a browser.")
    if model is not None:
        lines.append(f"Model: {model}. For the next flight: `--prior {_shell_word(model)}`")
    return lines


def gains_line(advice: Facts | None, seconds_by_use: Mapping[TimeUse, float]) -> str:
    """Returns a line on the controller gains that a session advises: their file, or why there are none.

    Args:
        advice: the facts (coded findings) of the latest advice; None where nothing was recorded to compute gains from.
        seconds_by_use: seconds of the session by what they were spent on, such as learning.

    Returns:
        One sentence, which the terminal prints at the end of a session.
    """
    if advice is None:
        return "No gains: they are computed from a recording, --record FILE.tlog."
    for fact in advice:
        if fact.code is GainFact.GAINS_WRITTEN:
            return f"Gains: {fact.figures['path']}. Load one file in a ground station."
    if advice:
        finding = _reason_without_gains(advice)
        if finding.code is GainFact.ADVICE_FAILED:
            # This sentence itself says that there are no gains.
            return finding.sentence
        reason = decisive_reason(finding)
        # A reason with a subject of its own, such as a motor, holds for all axes.
        axis = "" if reason.subject else finding.subject or finding.figures.get("axis")
        axis_text = f" for {axis}" if axis else ""
        # The first sentence is the reason; those that follow explain it, and the page has them.
        sentence = first_sentence(reason.sentence)
        return f"No gains{axis_text}: {as_clause(sentence.removeprefix('No margins: '))}."
    has_flown = seconds_by_use[TimeUse.LEARNED] > 0 or seconds_by_use[TimeUse.UNSETTLED] > 0
    if has_flown:
        return "No gains: too little settled flight to compute them from."
    return "No gains: nothing flew."


def _reason_without_gains(advice: Sequence[Fact]) -> Fact:
    """Finds the one reason why an advice has no gains to write to a file; the page has all.

    Args:
        advice: facts (coded findings) of the advice, at least one.

    Returns:
        The finding ``GAINS_LEFT`` (the gains are left unchanged), whose reason is the decisive one; without such a
        finding, the first of the advice.
    """
    for fact in advice:
        if fact.code is GainFact.GAINS_LEFT:
            return fact
    return advice[0]


def _shell_word(path: Path) -> str:
    """Returns a path as one word of a command line, in quotation marks if a shell would split it."""
    return quote(str(path))
