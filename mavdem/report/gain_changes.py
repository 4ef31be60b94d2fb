"""Gains to set as a page shows them: a table, cautions from facts (coded findings), and files for ground stations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import attrgetter
from pathlib import PurePath
from types import MappingProxyType
from typing import NamedTuple
from urllib.parse import quote

from mavdem.assessment.axis.lowered_gains import NO_GAINS, gain_names_by_axis
from mavdem.assessment.axis.parameter_sets import (
    LOWERED_GAINS_SUFFIX,
    ParameterSet,
    parameter_sets,
    present_parameter_files,
)
from mavdem.facts import Fact
from mavdem.facts.loops import GainFact
from mavdem.ingest.parameter_file import parameter_files
from mavdem.ingest.telemetry import Parameters, Telemetry
from mavdem.loops.advice import Advice, AdviceByAxis, Gain
from mavdem.loops.gain_design import SURE_SHARE, Stage
from mavdem.report.blocks import Block, Blocks, Sentence, Table
from mavdem.report.templates import render_section, sentences_by_axes
from mavdem.report.tuning.cautions import is_about_gains_to_set
from mavdem.report.tuning.gains import gain_row
from mavdem.report.tuning.tables import TRIED_HEADER

READERS = {".param": "Mission Planner, MAVProxy", ".params": "QGroundControl"}
"""Ground stations that read a parameter file, by the ending of its name."""

NO_PARAMETERS: Parameters = MappingProxyType({})
"""No parameters besides the gains."""


class ParameterDownload(NamedTuple):
    """A parameter file that a page holds within a link."""

    name: str
    """Name of the file."""

    label: str
    """Text of the link: the file's ending and who reads it."""

    address: str
    """The file as a ``data:`` address."""


class NewValue(NamedTuple):
    """A new value of a parameter, and when it is to be set."""

    text: str
    """The value."""

    later_stage: int | None = None
    """Number of the stage of tuning that it belongs to, if another stage is flown first; otherwise None."""

    is_tried: bool = False
    """Whether another flight is to confirm it, so that it is not to be loaded."""


class GainChanges(NamedTuple):
    """Gains to set before the next flight."""

    tables: tuple[Table, ...]
    """Each gain with its value now, the value to set, and the factor between them: one table for each flight."""

    downloads: tuple[ParameterDownload, ...]
    """The same as files."""

    tried_gains: Table | None = None
    """Such a table of the gains that another flight is to confirm before they are loaded, which are in no file."""

    cautions: Sequence[Block] = ()
    """Sentences on how far the gains can be trusted, which stand between the table and the files."""

    loading: Sequence[Sentence] = ()
    """Sentences on how advised gains are loaded and tried (:func:`loading_sentences`); empty without."""

    new_values: Mapping[str, NewValue] = MappingProxyType({})
    """The new value of each parameter in the tables, by its name."""

    is_after_check: bool = False
    """Whether the vehicle must not fly, and the gains be loaded, before something is checked or repaired."""

    @property
    def blocks(self) -> Blocks:
        """The tables of gains to load, in the order of the flights, and when those of stage 2 are loaded."""
        blocks = Blocks()
        for table in self.tables:
            if blocks:
                blocks += self.stage_sentences
            blocks.append(table)
        return blocks

    @property
    def tried_sentences(self) -> list[Sentence]:
        """The gains that another flight is to confirm, in a sentence, so that no one takes them for gains to load."""
        if self.tried_gains is None:
            return []
        return render_section("tried_gains", rows=self.tried_gains.rows)

    @property
    def stage_sentences(self) -> list[Sentence]:
        """The sentence that says when the gains of stage 2 are loaded; none if there is only one stage."""
        return render_section("gain_stages") if len(self.tables) > 1 else []

    @property
    def first_table(self) -> Table:
        """The gains to load before the next flight or, without any, those that were tried."""
        if self.tables:
            return self.tables[0]
        # Without gains to load some were tried, or there would be no changes.
        assert self.tried_gains is not None
        return self.tried_gains


def gain_changes(
    log_name: str,
    vehicle: Telemetry,
    advice: AdviceByAxis,
    gains_to_lower: Mapping[str, Gain] = NO_GAINS,
    notch_parameters: Parameters = NO_PARAMETERS,
    *,
    is_after_check: bool = False,
    oscillates: bool = False,
) -> GainChanges | None:
    """Returns a table of the gains to set after a flight, and parameter files with them to download.

    Where the control loop of an axis was identified, its gains are computed (the advice). On other axes gains may have
    to be lowered, for example because of an oscillation. If changes must not be loaded at once, each set that is flown
    by itself has a table and files of its own.

    Args:
        log_name: name of the log, after which the files are named.
        vehicle: the vehicle, with its present parameters.
        advice: for each axis the advice on its gains, or a fact that says why there is none. Advice that is not sound
            has to be confirmed by another flight: its gains are in a table of their own, and in no file.
        gains_to_lower: gains of axes without advice, by the autopilot's names.
        notch_parameters: parameters of the notch filter that the advised gains presuppose; they are set together with
            the first set of gains.
        is_after_check: whether something is to be checked or repaired before the gains are loaded.
        oscillates: whether the vehicle oscillates with its present gains, so that going back is warned of.

    Returns:
        The tables with their files; None if no gain changes.
    """
    advice_on_loops = [each for each in advice.values() if isinstance(each, Advice)]
    parameter_sets_to_fly = parameter_sets(advice_on_loops, notch_parameters, gains_to_lower)
    unconfirmed_gains = _changed_gains(each for each in advice_on_loops if not each.is_sound)
    if not parameter_sets_to_fly and not unconfirmed_gains:
        return None
    gains = {**_changed_gains(advice_on_loops), **gains_to_lower}
    tables = []
    for parameter_set in parameter_sets_to_fly:
        stage = _stage_of_set(parameter_set, parameter_sets_to_fly)
        tables.append(_table_of_set(parameter_set, stage, gains, vehicle))
    log_stem = PurePath(log_name).stem
    lowered_axes = gain_names_by_axis(gains_to_lower, vehicle.parameters)
    return GainChanges(
        tables=tuple(tables),
        downloads=tuple(
            _downloads_of_sets(
                parameter_sets_to_fly,
                log_stem,
                vehicle,
                is_after_check=is_after_check,
                oscillates=oscillates,
            )
        ),
        tried_gains=_table_of_tried_gains(unconfirmed_gains) if unconfirmed_gains else None,
        cautions=tuple(_cautions_on_gains(advice, lowered_axes)),
        new_values=_new_values(parameter_sets_to_fly, unconfirmed_gains),
        is_after_check=is_after_check,
    )


def gains_in_tables(changes: GainChanges | None) -> frozenset[str]:
    """Returns the names of the gains that a page lists in its tables of gains to load, so that texts need not.

    Gains that another flight has to confirm, so that they are not to be loaded, are left out.

    Args:
        changes: the tables; None if no gain changes.
    """
    if changes is None:
        return frozenset()
    return frozenset(name for name, value in changes.new_values.items() if not value.is_tried)


def _changed_gains(advice_on_loops: Iterable[Advice]) -> dict[str, Gain]:
    """Returns the gains that the advice on some axes changes, by the names of their parameters.

    Args:
        advice_on_loops: advice on each axis.
    """
    gains = {}
    for advice in advice_on_loops:
        for name in advice.parameters:
            gains[name] = advice.gains[name]
    return gains


def _stage_of_set(parameter_set: ParameterSet, sets: Sequence[ParameterSet]) -> int | None:
    """Returns the number of the tuning stage of a set of parameters; None if there is no other set to tell it from.

    Args:
        parameter_set: parameters that are loaded together.
        sets: all sets, which are loaded one after the other, with a flight between them.
    """
    return parameter_set.stage if len(sets) > 1 else None


def _table_of_set(
    parameter_set: ParameterSet, stage: int | None, gains: Mapping[str, Gain], vehicle: Telemetry
) -> Table:
    """Returns the table of parameters that are loaded together: value now, value to set, and the factor between them.

    Args:
        parameter_set: the parameters to set: gains, and perhaps those of a notch filter.
        stage: number of their stage of tuning; None if there is only one.
        gains: the gains that change, by the names of their parameters.
        vehicle: the vehicle, with its present parameters.
    """
    rows = []
    for name, value in parameter_set.parameters.items():
        if name in gains:
            rows.append(gain_row(name, gains[name]))
        else:
            rows.append(_notch_row(name, vehicle.parameters.get(name), value))
    header = "gain" if stage is None else f"gain, stage {stage:d}"
    return Table([header, "now", "set", "times"], rows)


def _table_of_tried_gains(gains: Mapping[str, Gain]) -> Table:
    """Returns the table of gains that another flight is to confirm before they are loaded.

    Args:
        gains: the gains, by the names of their parameters.
    """
    rows = [gain_row(name, gain) for name, gain in gains.items()]
    return Table(["gain", "now", TRIED_HEADER, "times"], rows)


def _downloads_of_sets(
    sets: Sequence[ParameterSet],
    log_stem: str,
    vehicle: Telemetry,
    *,
    is_after_check: bool,
    oscillates: bool,
) -> Iterator[ParameterDownload]:
    """Yields the files that load each set of parameters, and those that restore the present values.

    Args:
        sets: the sets in the order in which they are loaded.
        log_stem: name of the log without its ending, with which the names of the files begin.
        vehicle: the vehicle, with its present parameters.
        is_after_check: whether something is to be checked or repaired before they are loaded.
        oscillates: whether the vehicle oscillates with the present values.
    """
    changed_names: list[str] = []
    for parameter_set in sets:
        changed_names += parameter_set.parameters
        # Of several sets, a file on a disk is recognised by its name, as those that the command writes.
        suffix = "" if parameter_set.stage is None else parameter_set.suffix
        label = _label_of_set(parameter_set, is_after_check=is_after_check)
        files = parameter_files(parameter_set.parameters, vehicle, parameter_set.heading)
        yield from parameter_downloads(files, log_stem + suffix, label)
    if changed_names:
        present_files = present_parameter_files(changed_names, vehicle, oscillates=oscillates)
        label = "To go back (oscillates):" if oscillates else "To go back:"
        yield from parameter_downloads(present_files, log_stem, label)


def _label_of_set(parameter_set: ParameterSet, *, is_after_check: bool) -> str:
    """Returns what stands before the downloads of a set, such as "After the check: lower gains:"; empty without need.

    Args:
        parameter_set: the parameters to load at once.
        is_after_check: whether something is to be checked or repaired before they are loaded.
    """
    label = ""
    if parameter_set.stage is not None:
        label = f"Gains of stage {parameter_set.stage:d}:"
    elif parameter_set.suffix == LOWERED_GAINS_SUFFIX:
        label = "Lower gains:"
    if is_after_check:
        return f"After the check: {label[:1].lower()}{label[1:]}"
    return label


def _new_values(
    sets: Sequence[ParameterSet], tried_gains: Mapping[str, Gain]
) -> dict[str, NewValue]:
    """Returns the new value of each parameter, and when it is to be set, by the name of the parameter.

    Args:
        sets: parameters that are loaded together, in the order of their flights.
        tried_gains: gains that another flight is to confirm, by the names of their parameters.
    """
    new_values = {}
    for name, gain in tried_gains.items():
        new_values[name] = NewValue(f"{gain.set:.4g}", is_tried=True)
    for index, parameter_set in enumerate(sets):
        # The first set is loaded before the next flight.
        later_stage = None if index == 0 else _stage_of_set(parameter_set, sets)
        for name, value in parameter_set.parameters.items():
            new_values[name] = NewValue(f"{value:.4g}", later_stage)
    return new_values


def loading_sentences(advice_by_axis: AdviceByAxis) -> list[Sentence]:
    """Returns how the advised gains of the stage that comes first are loaded and tried; empty without sound gains.

    Args:
        advice_by_axis: for each axis the gains to set, or the fact (coded finding) why no gains are advised.
    """
    advice_of_stage = _advice_of_first_stage(advice_by_axis)
    if not advice_of_stage:
        return []
    # Axes of which another step follows have the fuller advice.
    advice_with_most_steps = max(advice_of_stage, key=attrgetter("flights"))
    return render_section(
        "gain_loading",
        stage=int(advice_with_most_steps.stage or 0),
        remedy=advice_with_most_steps.conclusion.remedy,
        is_noise_unknown=any(advice.noise is None for advice in advice_of_stage),
    )


def changes_on_trial(advice_by_axis: AdviceByAxis) -> int:
    """Returns the number of changes towards the margin goal of which the advised gains are the first, on trial.

    Gains are on trial if fewer than ``SURE_SHARE`` of the models of the vehicle have the required margins with them.

    Args:
        advice_by_axis: for each axis the gains to set, or the fact (coded finding) why no gains are advised.

    Returns:
        The number for the axis that needs the most, each with a flight after it; 0 if the gains are not on trial.
    """
    advice_of_stage = _advice_of_first_stage(advice_by_axis)
    if all(advice.sure >= SURE_SHARE for advice in advice_of_stage):
        return 0
    return max(advice.flights for advice in advice_of_stage)


def _advice_of_first_stage(advice_by_axis: AdviceByAxis) -> list[Advice]:
    """Returns the sound advice on gains of the stage that comes first, of all axes; empty without sound gains.

    Args:
        advice_by_axis: for each axis the gains to set, or the fact (coded finding) why no gains are advised.
    """
    advice_by_stage = dict[Stage, list[Advice]]()
    for advice in advice_by_axis.values():
        if isinstance(advice, Advice) and advice.parameters and advice.is_sound and advice.stage:
            advice_by_stage.setdefault(advice.stage, []).append(advice)
    return advice_by_stage[min(advice_by_stage)] if advice_by_stage else []


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


def _cautions_on_gains(advice: AdviceByAxis, lowered_axes: Iterable[str]) -> list[Sentence]:
    """Returns sentences on how far advised gains can be trusted; axes with the same caution share a sentence.

    There are three kinds. Gains are lowered without a model of the loop; or they are checked with many models of the
    vehicle that agree with the flight, and a sentence states the fraction of them with which the loops have the
    required margins. Other cautions are about the identification of the loop.

    Args:
        advice: for each axis the gains to set and the loop before the change, or the fact (coded finding) why no gains
            are advised.
        lowered_axes: axes whose gains are lowered without a model of the loop.
    """
    model_shares = []
    loop_cautions = []
    for axis, axis_advice in advice.items():
        if isinstance(axis_advice, Fact) or not axis_advice.parameters:
            continue
        model_share = Fact(
            GainFact.SHARE_OF_MODELS,
            share=axis_advice.sure,
            share_lacking=axis_advice.fraction_without_margins_before,
            is_sound=axis_advice.is_sound,
        )
        model_shares.append((axis, model_share))
        identified_loop = axis_advice.before
        for caution in identified_loop.cautions:
            if is_about_gains_to_set(caution):
                loop_cautions.append((axis, caution))
    lowered = [(axis, Fact(GainFact.LOWERED_WITHOUT_MODEL)) for axis in lowered_axes]
    sentences = sentences_by_axes([*lowered, *_least_share_first(model_shares)])
    sentences += sentences_by_axes(loop_cautions, attrgetter("sentence_and_remedy"))
    return sentences


def _least_share_first(model_shares: Sequence[tuple[str, Fact]]) -> list[tuple[str, Fact]]:
    """Sorts axes by the share of vehicle models with the required margins: the gains to trust least come first.

    Axes with the same sentence stay together, at the place of the one with the least share.

    Args:
        model_shares: axes with the fact that states the share, as its figure ``share`` from 0 to 1.
    """
    least_share_by_sentence = dict[str, float]()
    for _, fact in model_shares:
        sentence = str(fact)
        share = round(fact.figures["share"], 2)
        least_share_by_sentence[sentence] = min(share, least_share_by_sentence.get(sentence, share))
    return sorted(
        model_shares, key=lambda axis_and_fact: least_share_by_sentence[str(axis_and_fact[1])]
    )
