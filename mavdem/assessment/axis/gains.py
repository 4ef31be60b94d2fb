"""Changes of the controller's gains in a log: flight with constant gains, and facts (coded findings) on AutoTune."""

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mavdem.assessment.status_texts import StatusText, status_texts
from mavdem.dataset.flight_states import mode_intervals
from mavdem.dataset.intervals import Intervals
from mavdem.dataset.parameter_history import BEFORE_LOG, BootTime, parameter_history
from mavdem.dataset.signals import Signals
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.dem.learning import MIN_SAMPLES
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.loops import LoopFact
from mavdem.flight import Flight, Flights, boot_number
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import AUTOPILOT_SET_PARAMETERS, CONTROL_PARAMETERS
from mavdem.loops.axis_loops import Loop, margin_rating
from mavdem.loops.controllers import Controller
from mavdem.loops.gain_design import MAX_ANGLE_GAIN

AXIS_NAMES = {"roll": ("RLL", "ROLL"), "pitch": ("PIT",), "yaw": ("YAW",)}
"""Parts of the names of parameters that belong to one axis; ArduPilot's name has the first."""

AUTOTUNE_MODES = frozenset({"Autotune"})
"""ArduPilot's flight mode in which no parameter has the gains that are flown."""

AUTOTUNE_RESULT = re.compile(r"\b([PID]):(\d+\.?\d*)")
"""A gain in a text of ArduPilot's AutoTune: "Roll Rate: P:0.116, I:0.116, D:0.0006", "Roll Angle P:36.000"."""

GainValues = tuple[tuple[str, float], ...]
"""Names and values of the control parameters of one axis."""


class GainSet(NamedTuple):
    """The gains of one axis from a time on."""

    moment: BootTime
    """From when on; ``BEFORE_LOG`` for the gains from before the log."""
    values: GainValues
    """The gains."""


class OneGainSetSections(NamedTuple):
    """The sections of some flights that were flown with one set of gains."""

    flights: Flights
    """The sections; their provenance has these gains as parameters."""
    caution: Fact | None
    """That other sections, with other gains, were left out; None if there are none."""


@cached_per_vehicle("axis", "inputs")
def sections_with_one_gain_set(signals: Signals, flights: Flights) -> OneGainSetSections:
    """Selects the sections of flights with the one set of gains of the axis that was flown longest.

    A control loop can be identified only while its gains do not change. So each flight is cut at each change of the
    gains of the axis, the sections are grouped by their gains, and the group with the most samples is selected.
    Sections in ArduPilot's AutoTune are left out, since the gains that it tries are not logged as parameters. Sections
    that are too short to learn from are left out as well.

    Args:
        signals: signals of the vehicle and axis, with the parameters of the log.
        flights: settled flight of the axis.

    Returns:
        The sections, and a caution if anything was left out. Its figure ``parts`` contains the duration, s, of each
        other set of gains that was flown, and the gains that differ, the longest first. Its ``ratings`` are empty until
        :func:`mavdem.assessment.axis.loops.loop_of_axis` adds the margins with those gains.

    Raises:
        NotLearnable: no section is left.
    """
    sections_by_gains = _sections_by_gains(signals, flights)
    if not sections_by_gains:
        raise NotLearnable(LoopFact.GAINS_OF_AUTOTUNE)
    sample_counts = {
        gains: sum(map(len, sections)) for gains, sections in sections_by_gains.items()
    }
    longest_flown_gains = max(sample_counts, key=lambda gains: sample_counts[gains])
    sections_of_longest = sections_by_gains.pop(longest_flown_gains)
    sections_with_gains = tuple(
        _with_gains(section, longest_flown_gains) for section in sections_of_longest
    )
    # No caution is needed if nothing was left out.
    if sample_counts[longest_flown_gains] == sum(map(len, flights)):
        return OneGainSetSections(sections_with_gains, caution=None)
    # Each entry is the duration for which another set of gains was flown, and the gains that differ.
    other_sets = []
    changed_names = set[str]()
    for gains, sections in sections_by_gains.items():
        differing_gains = sorted(set(gains) - set(longest_flown_gains))
        duration = sum(section.duration for section in sections)
        other_sets.append((duration, differing_gains))
        changed_names.update(name for name, _ in differing_gains)
    caution = Fact(
        LoopFact.GAINS_OF_PART,
        names=sorted(changed_names),
        parts=sorted(other_sets, reverse=True),
        ratings=(),
        duration=sum(section.duration for section in sections_with_gains),
        settled=sum(flight.duration for flight in flights),
    )
    return OneGainSetSections(sections_with_gains, caution)


def _sections_by_gains(signals: Signals, flights: Flights) -> dict[GainValues, list[Flight]]:
    """Cuts flights at each change of the gains of the axis, and groups the sections by their gains.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        flights: samples of the axis in settled flight.

    Returns:
        By a set of gains, the sections of flight with these gains: at least ``MIN_SAMPLES`` samples each, and without
        sections in which AutoTune tried gains.
    """
    history = gain_history(signals)
    sections_by_gains = defaultdict[GainValues, list[Flight]](list)
    for flight in flights:
        boot = boot_number(flight)
        autotune_intervals = mode_intervals(signals, boot, AUTOTUNE_MODES)
        section_bounds = _samples_of_changes(flight, history, autotune_intervals)
        for first_sample, end_sample in pairwise(section_bounds):
            start_time = flight.time[first_sample]
            # Flights are cut at both ends of AutoTune, so that a section is in it as a whole or not at all.
            is_in_autotune = any(
                autotune_start <= start_time < autotune_end
                for autotune_start, autotune_end in autotune_intervals
            )
            if is_in_autotune or end_sample - first_sample < MIN_SAMPLES:
                continue
            gains = _gains_at(history, BootTime(boot, start_time))
            sections_by_gains[gains].append(flight[first_sample:end_sample])
    return sections_by_gains


def _samples_of_changes(
    flight: Flight, history: Sequence[GainSet], autotune: Intervals
) -> list[int]:
    """Returns the samples at which a flight must be cut so that the gains are constant in each section.

    It is cut whenever gains were set, and at the start and the end of each interval of AutoTune.

    Args:
        flight: samples of one boot.
        history: gains, each with the time, s since boot, at which it was set.
        autotune: start and end of the intervals in which AutoTune changed gains, s since boot.

    Returns:
        Ascending indices of samples. The first is 0 and the last the number of samples, so that each pair of neighbours
        bounds one section.
    """
    boot = boot_number(flight)
    cut_times = [gain_set.moment.time for gain_set in history if gain_set.moment.boot == boot]
    for start, end in autotune:
        cut_times += [start, end]
    samples_of_cuts = np.searchsorted(flight.time, cut_times)
    section_bounds: list[int] = np.unique([0, *samples_of_cuts, len(flight)]).tolist()
    return section_bounds


def _gains_at(history: Sequence[GainSet], moment: BootTime) -> GainValues:
    """Looks up the gains that applied at a time of a boot.

    Args:
        history: gains in the order of boot and time. The first entry is from before the log, so that one always
            applies.
        moment: boot and time, s.

    Returns:
        The gains of the last entry at or before the time.
    """
    earlier_sets = [gain_set for gain_set in history if gain_set.moment <= moment]
    return earlier_sets[-1].values


def _with_gains(flight: Flight, gains: GainValues) -> Flight:
    """Returns a copy of a flight whose provenance has these ``gains`` as parameters, and no changes of parameters."""
    provenance = flight.provenance
    parameters = {**provenance["parameters"], **dict(gains)}
    return replace(flight, provenance={**provenance, "parameters": parameters, "earlier": {}})


def gain_history(signals: Signals) -> list[GainSet]:
    """Returns the sets of gains that the controller of one axis had in a log, one after another.

    Every change of a gain's value adds a set. The first set is valid from before the log on: it has the value of each
    gain that was reported first.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.

    Returns:
        Sets of gains in the order of the log, each with the boot and time from which on it was valid.
    """
    history = parameter_history(signals)
    gains = {}
    for name, value in history.at(BEFORE_LOG).items():
        if _is_gain_of_axis(name, signals.axis):
            gains[name] = value
    gain_sets = [GainSet(BEFORE_LOG, tuple(gains.items()))]
    changes = []
    for name in gains.keys() & history.settings.keys():
        for setting in history.settings[name][1:]:
            changes.append((setting.moment, name, setting.value))
    for moment, name, value in sorted(changes):
        gains[name] = value
        gain_sets.append(GainSet(moment, tuple(gains.items())))
    return gain_sets


def _is_gain_of_axis(name: str, axis: str) -> bool:
    """Returns whether a parameter is a gain, or another setting, of the control of an axis.

    Parameters without the name of an axis belong to all axes. Parameters that the autopilot sets itself, such as a
    learned hover thrust, do not count: nobody changed them.

    Args:
        name: name of the parameter, such as "ATC_RAT_RLL_P".
        axis: "roll", "pitch" or "yaw".
    """
    if CONTROL_PARAMETERS.match(name) is None or AUTOPILOT_SET_PARAMETERS.search(name) is not None:
        return False
    for other_axis, names_of_axis in AXIS_NAMES.items():
        if other_axis != axis and any(axis_name in name for axis_name in names_of_axis):
            return False
    return True


def changed_gains_at_end(signals: Signals, controller: Controller) -> Fact | None:
    """Returns the fact that a log ends with other gains of an axis than a control loop was identified with.

    A pilot, or AutoTune, may have changed them after the flight that the loop is identified from. The vehicle still has
    the gains that it had at the end of the log or, if that is a part of a recording, at the end of the recording.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        controller: controller of the loop, with the parameters that it was identified with.

    Returns:
        The fact; None if no gain differs. Its ``changes`` are, for each gain that does, its name, its value in the loop
        and its value at the end of the log.
    """
    later_values = signals.telemetry.later_parameters
    changes = []
    for name, value_at_end in gain_history(signals)[-1].values:
        value = later_values.get(name, value_at_end)
        value_of_loop = controller.parameters.get(name, value)
        if value_of_loop != value:
            changes.append((name, value_of_loop, value))
    return Fact(LoopFact.GAINS_SINCE, changes=sorted(changes)) if changes else None


def loop_at_end_of_log(loop: Loop) -> Loop:
    """Returns a loop with the gains at the end of its log, which the vehicle still has.

    A pilot may have changed gains after the flight that the loop was identified from. Advice on gains starts from the
    gains that the vehicle has now.

    Args:
        loop: an identified loop. If gains were changed later, the fact of :func:`changed_gains_at_end` is among its
            cautions.

    Returns:
        The loop of the same plant with these gains; the loop itself if no gain was changed, or the gains make no
        complete controller.
    """
    for caution in loop.cautions:
        if caution.code is not LoopFact.GAINS_SINCE:
            continue
        gains_at_end = {}
        for name, _value_in_loop, value_at_end in caution.figures["changes"]:
            gains_at_end[name] = value_at_end
        with suppress(NotLearnable):
            return loop.with_parameters(gains_at_end)
    return loop


def autotune_fact(signals: Signals, loop: Loop | Fact) -> Fact | None:
    """Returns the fact that AutoTune tuned an axis, with the gains before and after; None if it did not.

    AutoTune is recognised by its texts (ArduPilot), or by the signal that it injects (PX4). The gains before it are the
    parameters when it began. The gains after it are the parameters at the log's end if they differ, and otherwise the
    gains that AutoTune reported in its texts.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        loop: the control loop of the axis, with which the margins of both sets of gains are rated; or why it is not
            known.

    Returns:
        The fact, whose level is at most "watch" by the margins with the gains after AutoTune.
    """
    texts = _autotune_texts(signals)
    moments = [BootTime(text.boot, text.time) for text in texts]
    if signals.telemetry.autopilot == "PX4":
        moments += _excitation_moments(signals)
    if not moments:
        return None
    start = min(moments)
    end_time = max(moment.time for moment in moments if moment.boot == start.boot)
    history = gain_history(signals)
    gains_before = dict(_gains_at(history, start))
    # Parameters at the end of the log that differ from those before AutoTune were saved by it.
    saved_gains = {name: value for name, value in history[-1].values if gains_before[name] != value}
    # Saved gains replace those that AutoTune reported in its texts.
    gains_after = gains_before | _reported_gains(texts, signals.axis) | saved_gains
    changes = _changed_gains(gains_before, gains_after)
    fact = Fact(
        LoopFact.AUTOTUNED,
        time=start.time,
        end_time=end_time,
        subject=signals.axis,
        boot=start.boot,
        changes=changes,
        is_saved=bool(saved_gains),
        too_large=_too_large_gains(changes, signals.axis),
        ratings=(),
    )
    if isinstance(loop, Fact):
        return fact
    ratings = margin_ratings(loop, (gains_before, gains_after))
    if not ratings:
        return fact
    _, rating_after = ratings
    # Margins that are bad are only to be watched, since the gains may not have been flown. Levels ascend in ``Level``.
    level = min(rating_after.level, Level.WATCH, key=list(Level).index)
    return fact.replace(level, ratings=ratings)


def _changed_gains(
    gains_before: Mapping[str, float], gains_after: Mapping[str, float]
) -> list[tuple[str, float | None, float]]:
    """Lists the gains that differ between two sets, each with its value before (None if unknown) and after."""
    changes = []
    for name, value in gains_after.items():
        value_before = gains_before.get(name)
        if value_before != value:
            changes.append((name, value_before, value))
    return changes


def _too_large_gains(
    changes: Sequence[tuple[str, float | None, float]], axis: str
) -> list[tuple[str, float, float]]:
    """Returns those changed gains of ArduPilot's attitude loop that are larger than recommended.

    ArduPilot recommends one largest gain for all axes. It equals the largest gain that PX4 accepts for roll and pitch.

    Args:
        changes: name of each changed gain, and its values before and after.
        axis: "roll", "pitch" or "yaw".

    Returns:
        Name and value of each of these gains, and the largest recommended value.
    """
    largest_angle_gain = max(MAX_ANGLE_GAIN.values())
    angle_gain_name = f"ATC_ANG_{AXIS_NAMES[axis][0]}_P"
    too_large = []
    for name, _, value in changes:
        if name == angle_gain_name and value > largest_angle_gain:
            too_large.append((name, value, largest_angle_gain))
    return too_large


def _autotune_texts(signals: Signals) -> list[StatusText]:
    """Collects the messages of ArduPilot's AutoTune on the axis of ``signals``.

    They begin like "AutoTune: Yaw Rate" and, for a yaw that is tuned by its error's filter or by D, "AutoTune: Yaw(E)"
    or "AutoTune: Yaw(D)".

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.

    Returns:
        The messages, in the order of the log.
    """
    name = f"AutoTune: {signals.axis.capitalize()}"
    beginnings = (f"{name} ", f"{name}(")
    return [text for text in status_texts(signals.telemetry) if text.text.startswith(beginnings)]


def _excitation_moments(signals: Signals) -> list[BootTime]:
    """Returns the times of all samples at which the autopilot injected a signal into the axis of ``signals``.

    PX4's AutoTune excites the axis by such a signal to identify it. The recorded signal is 0 at all other times.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.

    Returns:
        Boot and time, s since boot, of each sample.
    """
    moments = []
    for injected in signals.injected_signals:
        series = injected.signal
        for sample in np.flatnonzero(series.values):
            moments.append(BootTime(series.boot[sample], series.time[sample]))
    return moments


def _reported_gains(texts: Sequence[StatusText], axis: str) -> dict[str, float]:
    """Returns the gains that AutoTune reported in its texts, by the names of ArduPilot's parameters.

    The name of a parameter consists of the loop, the axis and the letter of the gain, such as ATC_RAT_RLL_P. A later
    text replaces an earlier one.

    Args:
        texts: texts of AutoTune on the axis, such as "AutoTune: Roll Rate: P:0.116, I:0.116, D:0.0006". A text with the
            word "Angle" has gains of the attitude loop, every other text has gains of the rate loop.
        axis: "roll", "pitch" or "yaw".

    Returns:
        Values by the name of the parameter.
    """
    gains = {}
    # ArduPilot's name of the axis: RLL, PIT or YAW.
    axis_infix = AXIS_NAMES[axis][0]
    for status_text in texts:
        if "Angle" in status_text.text:
            loop_infix = "ANG"
        else:
            loop_infix = "RAT"
        for gain_letter, gain in AUTOTUNE_RESULT.findall(status_text.text):
            gains[f"ATC_{loop_infix}_{axis_infix}_{gain_letter}"] = float(gain)
    return gains


def margin_ratings(loop: Loop, gain_sets: Iterable[Parameters]) -> Facts:
    """Returns the rating of a loop's stability margins with each of several sets of gains.

    The plant stays as it was identified; only the controller is built again with each set.

    Args:
        loop: the identified plant with its controller.
        gain_sets: parameters to change, by the autopilot's names.

    Returns:
        The margin rating (a fact) of each set; empty if any of the sets makes no complete controller.
    """
    try:
        return tuple(margin_rating(loop.with_parameters(gains)) for gains in gain_sets)
    except NotLearnable:
        return ()
