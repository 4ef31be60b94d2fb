"""Gains to set as a page shows them: a table, cautions from facts (coded findings), and files for ground stations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from pathlib import PurePath
from types import MappingProxyType
from typing import NamedTuple
from urllib.parse import quote

from mavdem.assessment.axis.tuning import STAGE_HEADINGS, present_parameter_files
from mavdem.facts import Fact
from mavdem.facts.loops import GainFact, LoopAction
from mavdem.ingest.parameter_file import parameter_files
from mavdem.ingest.telemetry import Parameters, Telemetry
from mavdem.loops.advice import AdviceByAxis, Gain
from mavdem.loops.gain_design import SURE_SHARE, Stage
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.loops import is_about_gains_to_set
from mavdem.report.templates import sentences_by_axes

READERS = {".param": "Mission Planner, MAVProxy", ".params": "QGroundControl"}
"""Ground stations that read a parameter file, by the ending of its name."""

LOWERING = (GainFact.LOWER_GAINS, LoopAction.LOWER_BY_A_THIRD)
"""Facts whose ``changes`` are gains to lower: name, value now and value to set."""

NO_PARAMETERS: Parameters = MappingProxyType({})
"""No parameters besides the gains."""

LOWERED_GAINS_HEADING = "Gains to lower before the next flight"
"""First line of the parameter files of gains to lower."""


class ParameterDownload(NamedTuple):
    """A parameter file that a page holds within a link."""

    name: str
    """Name of the file."""

    label: str
    """Text of the link: the file's ending and who reads it."""

    address: str
    """The file as a ``data:`` address."""


class GainChanges(NamedTuple):
    """Gains to set before the next flight."""

    table: Table
    """Each gain with its value now, the value to set, and the factor between them."""

    downloads: tuple[ParameterDownload, ...]
    """The same as files."""

    cautions: Sequence[Block] = ()
    """Sentences on how far the gains can be trusted, which stand between the table and the files."""

    is_result: bool = False
    """Whether the gains are the result of the page, which shows their table and folds the cautions."""


class _GainSet(NamedTuple):
    """Gains that are loaded together."""

    gains: Mapping[str, Gain]
    """Gains that change, by the autopilot's name."""

    heading: str
    """First line of their parameter files."""

    suffix: str = ""
    """End of the name of their files, before the ending."""

    label: str = ""
    """What their files are for, in the text of the links; empty if there is one set alone."""


def gain_changes(
    log_name: str,
    vehicle: Telemetry,
    advice: AdviceByAxis,
    next_step: Fact,
    notch_parameters: Parameters = NO_PARAMETERS,
) -> GainChanges | None:
    """Returns a table of the gains to set after a judged flight, and parameter files with them to download.

    These are the gains to lower, if the next step of the judgement names some, and otherwise the advised gains.

    Args:
        log_name: name of the log, after which the files are named.
        vehicle: the vehicle, with its present parameters.
        advice: advised gains by axis, or why there are none.
        next_step: next step of the judgement.
        notch_parameters: parameters of the notch filter that the advised gains presuppose; they are set together with
            the first set of gains.

    Returns:
        The table with its files; None if no gain changes.
    """
    lowered_gains = dict(_gains_to_lower(next_step))
    if lowered_gains:
        gain_sets = [_GainSet(lowered_gains, LOWERED_GAINS_HEADING)]
    else:
        gain_sets = [*_advised_gain_sets(advice)]
    rows = []
    downloads: list[ParameterDownload] = []
    changed_names: list[str] = []
    log_stem = PurePath(log_name).stem
    for index, gain_set in enumerate(gain_sets):
        values = {}
        for name, gain in gain_set.gains.items():
            values[name] = gain.set
            rows.append(_gain_row(name, gain))
        is_first_set = index == 0
        if is_first_set:
            # The filter stays set for the gains of later stages.
            for name, value in notch_parameters.items():
                values[name] = value
                rows.append(_notch_row(name, vehicle.parameters.get(name), value))
        changed_names += values
        files = parameter_files(values, vehicle, gain_set.heading)
        downloads += parameter_downloads(files, log_stem + gain_set.suffix, gain_set.label)
    if not rows:
        return None
    downloads += parameter_downloads(
        present_parameter_files(changed_names, vehicle), log_stem, "To go back:"
    )
    cautions = () if lowered_gains else tuple(_cautions_on_gains(advice))
    return GainChanges(Table(["gain", "now", "set", "times"], rows), tuple(downloads), cautions)


def _gain_row(name: str, gain: Gain) -> list[str]:
    """Returns the row of a gain: its name, value now, value to set, and the factor between them (1 for a gain of 0)."""
    factor = gain.set / gain.now if gain.now else 1.0
    return [name, f"{gain.now:.4g}", f"{gain.set:.4g}", f"{factor:.2f}"]


def _notch_row(name: str, present_value: float | None, value: float) -> list[str]:
    """Returns the row of a parameter of a notch filter, which has no factor; the value now is empty if not known."""
    present_text = "" if present_value is None else f"{present_value:.4g}"
    return [name, present_text, f"{value:.4g}", ""]


def parameter_downloads(
    files: Mapping[str, str], stem: str, purpose: str
) -> Iterator[ParameterDownload]:
    """Yields the links to the files that set some parameters, one for each kind of ground station.

    Args:
        files: text of each file, by the ending of its name, such as ``.params`` or ``.before.params``.
        stem: name of the files without the ending.
        purpose: what the files are for, with which the text of each link begins; empty for none.
    """
    for ending in sorted(files):
        name = f"{stem}{ending}"
        kind = PurePath(name).suffix
        label = f"{purpose} {kind} ({READERS[kind]})".strip()
        address = f"data:text/plain;charset=utf-8,{quote(files[ending])}"
        yield ParameterDownload(name, label, address)


def _cautions_on_gains(advice: AdviceByAxis) -> list[Sentence]:
    """Returns sentences on how far advised gains can be trusted; axes with the same caution share a sentence.

    There are two kinds. Gains are checked with many models of the vehicle that agree with the flight; if the loops have
    the required margins with too few of them, a sentence states the fraction. Other cautions are about the
    identification of the loop.

    Args:
        advice: for each axis the gains to set and the loop before the change, or the fact (coded finding) why no gains
            are advised.
    """
    model_fractions = []
    loop_cautions = []
    for axis, axis_advice in advice.items():
        if isinstance(axis_advice, Fact) or not axis_advice.parameters:
            continue
        if axis_advice.sure < SURE_SHARE:
            model_fraction = Fact(
                GainFact.SHARE_OF_MODELS,
                share=axis_advice.sure,
                share_lacking=axis_advice.fraction_without_margins_before,
                is_sound=axis_advice.is_sound,
            )
            model_fractions.append((axis, model_fraction))
        identified_loop = axis_advice.before
        for caution in identified_loop.cautions:
            if is_about_gains_to_set(caution):
                loop_cautions.append((axis, caution))
    sentences = sentences_by_axes(model_fractions)
    sentences += sentences_by_axes(loop_cautions, attrgetter("sentence_and_remedy"))
    return sentences


def _advised_gain_sets(advice: AdviceByAxis) -> Iterator[_GainSet]:
    """Yields the advised gains of all axes as sets to load into the autopilot one after the other.

    Rate loops are tuned before the attitude loops around them. So the gains of the first stage of tuning are flown
    before the gains of the second stage are loaded.

    Args:
        advice: advice by axis, or the fact (coded finding) why there is none.

    Yields:
        A set for each stage. If there are several stages, each set has a suffix for the name of its file.
    """
    gains_by_stage: dict[Stage, dict[str, Gain]] = {}
    for axis_advice in advice.values():
        if isinstance(axis_advice, Fact) or axis_advice.stage is None:
            continue
        changed_gains = {name: axis_advice.gains[name] for name in axis_advice.parameters}
        gains_by_stage.setdefault(axis_advice.stage, {}).update(changed_gains)
    has_several_stages = len(gains_by_stage) > 1
    for stage, gains in sorted(gains_by_stage.items()):
        if has_several_stages:
            suffix, label = f".stage{stage:d}", f"Stage {stage:d}"
        else:
            suffix, label = "", ""
        yield _GainSet(gains, STAGE_HEADINGS[stage], suffix, label)


def _gains_to_lower(fact: Fact) -> Iterator[tuple[str, Gain]]:
    """Yields each gain that a fact advises to lower: its name, and the gain with its value now and the value to set.

    The fact of a next step does not hold the gains itself: its figures are other facts, such as its reason, whose
    figures may be facts again. One of these may be the advice to lower gains, so that all of them are searched.

    Args:
        fact: next step (a coded finding), or a fact among its figures, which advises to lower gains.
    """
    if fact.code in LOWERING:
        for name, present_value, new_value in fact.figures["changes"]:
            yield name, Gain(present_value, new_value)
    for figure in fact.figures.values():
        # A figure is a value or a tuple of values.
        values = figure if isinstance(figure, tuple) else (figure,)
        for value in values:
            if isinstance(value, Fact):
                yield from _gains_to_lower(value)
