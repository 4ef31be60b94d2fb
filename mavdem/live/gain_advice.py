"""Controller gains that are advised after a landing, as ``mavdem tune`` computes them from the session's recording.

They are computed in a process of its own, which begins when the vehicle has landed, or at the end of the session, and
ends with its advice. Nothing is sent to the vehicle.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.assessment.axis.tuning import Tuning, tune_loops
from mavdem.assessment.axis.twin import predicted_errors
from mavdem.assessment.judgement import Judgement
from mavdem.dataset.axes import AXES
from mavdem.dem.parallel import LOW_PRIORITY, NORMAL_PRIORITY
from mavdem.errors import Refusal, error_message
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import GainFact, LoopAction, LoopFact
from mavdem.facts.session import RecordingState, SessionFact
from mavdem.files import atomic_writes
from mavdem.ingest import read_log
from mavdem.live.latest_flight import log_of_latest_flight
from mavdem.loops.advice import Advice

MAX_WAIT_SECONDS = 60.0
"""Time that the end of a session waits for advice, s, which the user is shown: a choice.

All else that is known has been reported by then. Advice takes some seconds on a free core.
"""

FINDINGS_WITH_REASONS = (GainFact.NO_GAINS_ADVISED, LoopFact.NO_LOOP)
"""Findings on control loops with a figure "reasons": several other findings, such as one for each axis."""

FINDINGS_WITH_ONE_REASON = (GainFact.GAINS_LEFT, LoopAction.LOOPS_JUDGED, LoopFact.NO_MARGINS)
"""Findings on control loops with a figure "reason": one other finding, that decides."""


class GainAdvice(NamedTuple):
    """What the recording of a session shows of its control loops."""

    facts: Facts
    """Which gains, what to expect of them, and their files; or why there are none."""

    judgement: Judgement | None = None
    """The judgement of the vehicle by the recording; None where that cannot be judged."""


class GainAdviser:
    """Has controller gains computed in another process, from the growing recording of a session.

    Attributes:
        facts: the latest advice: which gains, what to expect of them, and their files; or why there are none.
        judgement: the judgement of the vehicle by the recording, which the latest advice comes with; None without one,
            and while advice on a later flight is due or being computed.
        is_due: whether the vehicle has landed since the latest advice began.
    """

    def __init__(self, recording: Path, start_executor: Callable[[int], Executor]) -> None:
        """Prepares the computation of advice on gains from a session's recording; there is no advice yet.

        Args:
            recording: the file that the session records into.
            start_executor: starts the process that computes advice, with a niceness: 0 for normal priority.
        """
        self.facts: Facts = ()
        self.judgement: Judgement | None = None
        self.is_due = False
        self._recording = recording
        self._start_executor = start_executor
        self._process = ExitStack()
        self._pending: Future[GainAdvice] | None = None

    @property
    def is_awaited(self) -> bool:
        """Whether advice is due or being computed."""
        return self.is_due or self._pending is not None

    @property
    def recording_failure(self) -> Fact | None:
        """The fact that the recording of the latest flight could not be judged; None if it was, or still may be.

        The recording is judged in the computation of the advice, so that a failure of that, or too long a time, is the
        cause.
        """
        has_advice_failed = any(fact.code is GainFact.ADVICE_FAILED for fact in self.facts)
        if self.is_awaited or not has_advice_failed:
            # While advice on a newer flight is computed, an earlier failure says nothing of that flight.
            return None
        return Fact(
            SessionFact.RECORDING_NOT_JUDGED,
            kind=RecordingState.FAILED,
            path=str(self._recording),
        )

    def update(
        self, vehicle: str, *, is_busy: bool, is_at_end: bool, thrust_loss: Fact | None = None
    ) -> Facts:
        """Begins to compute advice that is due, and returns advice that is ready; it is called once a second.

        It waits for advice only at the end of the session, for ``MAX_WAIT_SECONDS`` at most.

        Args:
            vehicle: "system:component".
            is_busy: whether the computer has no time for advice; then it is put off, except at the end.
            is_at_end: whether the session ends, so that the call must wait for advice that is not ready.
            thrust_loss: the loss of thrust of a motor that was found in the flight; None for none.

        Returns:
            The facts of the advice, once, when it is ready; the fact that it is put off; otherwise nothing. The
            judgement of the recording, which comes with advice, is then in ``judgement``.
        """
        if self.is_due:
            # The judgement that came with the last advice is about an earlier flight.
            self.judgement = None
            if is_busy and not is_at_end:
                return (Fact(GainFact.ADVICE_WAITS),)
            niceness = LOW_PRIORITY
            if is_at_end:
                # No sample waits for a core any more, and on a busy computer low priority would take too long.
                niceness = NORMAL_PRIORITY
            self._start_computation(vehicle, thrust_loss, niceness)
        if self._pending is None:
            # No advice is being computed.
            return ()
        # Only the end of a session waits for the other process, nothing in flight does.
        if not is_at_end and not self._pending.done():
            return ()
        self.facts, self.judgement = self._awaited_result(self._pending)
        # The next advice gets a process of its own.
        self.close()
        return self.facts

    def _start_computation(self, vehicle: str, thrust_loss: Fact | None, niceness: int) -> None:
        """Starts the computation of advice in a new process; it is no longer due.

        Advice that is still being computed is given up: it lacks the latest flight.

        Args:
            vehicle: "system:component".
            thrust_loss: the loss of thrust of a motor that was found in the flight; None for none.
            niceness: priority of the process, 0 for normal.
        """
        self.is_due = False
        self.close()
        executor = self._process.enter_context(self._start_executor(niceness))
        self._pending = executor.submit(advise_gains, self._recording, vehicle, thrust_loss)

    def _awaited_result(self, pending: Future[GainAdvice]) -> GainAdvice:
        """Waits for advice, ``MAX_WAIT_SECONDS`` at most, and returns it.

        Args:
            pending: the advice that an executor computes.

        Returns:
            The advice. If computing it failed or took too long, it contains only the fact that states it.
        """
        try:
            return pending.result(MAX_WAIT_SECONDS)
        except Exception as error:
            # Whatever fails in the other process, or takes too long, must not end the session.
            failure = Fact(
                GainFact.ADVICE_FAILED,
                error=error_message(error),
                duration=MAX_WAIT_SECONDS,
                path=str(self._recording),
            )
            return GainAdvice((failure,))

    def close(self) -> None:
        """Ends the process, even if it is still computing advice."""
        self._pending = None
        self._process.close()


def advise_gains(recording: Path, vehicle: str, thrust_loss: Fact | None = None) -> GainAdvice:
    """Advises gains for all axes from the latest flight of a recording, and writes them to files next to it.

    The gains are those of ``mavdem tune`` on a recording of that flight alone.

    Args:
        recording: the recording, which may still grow.
        vehicle: "system:component" of the vehicle in it.
        thrust_loss: the loss of thrust of a motor that was found in the flight, even if the recording is too short to
            show it; None for none. No gains are advised with it, since those of a sound vehicle are not known.

    Returns:
        The judgement of the vehicle, and facts: the new gains of each axis, their effect in a simulation of the vehicle
        (its twin), and the files; for axes without new gains, the decision on their control loops; or why no gains are
        advised at all.

    Raises:
        OSError: the files cannot be written.
    """
    try:
        log = log_of_latest_flight(read_log(recording))
        assessment = assess(log, vehicle, AXES[0], Options(with_model=False))
    except Refusal as error:
        return GainAdvice((Fact(GainFact.GAINS_LEFT, reason=_root_cause(error.fact)),))
    if thrust_loss is not None:
        gains_left = Fact(GainFact.GAINS_LEFT, reason=thrust_loss)
        return GainAdvice((gains_left,), assessment.judgement)
    # Only an assessment in which no vehicle was judged has no evidence.
    assert assessment.evidence is not None
    tuning = tune_loops(assessment, AXES, is_written=True)
    if tuning.no_loop is not None:
        gains_left = Fact(GainFact.GAINS_LEFT, reason=_root_cause(tuning.no_loop))
        return GainAdvice((gains_left,), assessment.judgement)
    facts = facts_of_tuning(tuning)
    texts: Mapping[str, str] = {}
    if tuning.parameters:
        texts = tuning.files(assessment.evidence.signals.telemetry)
    if not texts:
        # No gains change, or another flight is to confirm them before they are loaded.
        return GainAdvice(facts, tuning.judgement)
    # The new gains of all axes by the names of their parameters.
    confirmed_gains = dict[str, float]()
    for parameter_set in tuning.sets:
        confirmed_gains |= parameter_set.parameters
    simulated_effects = predicted_errors(assessment.evidence, confirmed_gains)
    files_fact = _write_gain_files(recording, texts, tuning.judgement.next_step)
    return GainAdvice((*facts, *simulated_effects, files_fact), tuning.judgement)


def _write_gain_files(recording: Path, texts: Mapping[str, str], next_step: Fact) -> Fact:
    """Writes the files with new gains next to a recording, either all of them or none.

    Args:
        recording: path of the session's recording, such as ``flight.tlog``.
        texts: text of each file by the ending of its name, such as ``.params``.
        next_step: what the pilot should do with the files.

    Returns:
        The fact (a coded finding) ``GAINS_WRITTEN``. Its figure ``path`` names the files, such as
        ``flight.gains.params``, and its figure ``reason`` is the next step.

    Raises:
        OSError: a file cannot be written.
    """
    stem = _unused_stem(recording, list(texts))
    files = [Path(stem + ending) for ending in texts]
    # An empty or partial file must never be loaded into a vehicle.
    with atomic_writes(*files) as unfinished_files:
        for file, text in zip(unfinished_files, texts.values(), strict=True):
            file.write_text(text, encoding="utf-8")
    path = stem + " and ".join(texts)
    return Fact(GainFact.GAINS_WRITTEN, path=path, reason=next_step)


def facts_of_tuning(tuning: Tuning) -> Facts:
    """Returns what a live session reports about the gains after a flight.

    Args:
        tuning: the advice on all axes.

    Returns:
        Facts (coded findings) in this order:

        1. for each axis with new gains to load: these gains;
        2. for each other axis that needs an action, such as another flight: the decision on its loops;
        3. for the other axes: why their gains stay as they are, once for all axes with the same reason.
    """
    facts_on_new_gains = []
    facts_without_gains = []
    axes_by_reason: dict[Fact, list[str]] = {}
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Advice) and advice.parameters and advice.is_sound:
            facts_on_new_gains.append(_new_gains_fact(axis, advice))
            continue
        decision = tuning.judgement.loop_decisions.get(axis)
        if decision is not None and decision.action is not None:
            # The list of events has nothing else that names the axis.
            facts_without_gains.append(decision.fact.replace(is_named=True))
            continue
        # Without advice there is a fact with the reason in its place.
        conclusion = advice.conclusion if isinstance(advice, Advice) else advice
        axes_by_reason.setdefault(_root_cause(conclusion), []).append(axis)
    for reason, axes in _merge_axes_with_good_gains(axes_by_reason).items():
        facts_without_gains.append(Fact(GainFact.GAINS_LEFT, axes=tuple(axes), reason=reason))
    return (*facts_on_new_gains, *facts_without_gains)


def _merge_axes_with_good_gains(
    axes_by_reason: Mapping[Fact, Sequence[str]],
) -> dict[Fact, Sequence[str]]:
    """Merges the axes whose gains are good as they are, so that one sentence reports all of them.

    Their reasons differ only in the share of vehicle models that reach the margins, such as 95 % for roll and 90 % for
    pitch. The merged axes get the reason with the least share, which every one of them reaches.

    Args:
        axes_by_reason: the axes by the reason why their gains stay.

    Returns:
        The axes by reason, with one reason to keep gains at most. Other reasons, such as a log that is too slow, stay
        apart.
    """
    reasons_to_keep = [reason for reason in axes_by_reason if reason.code is GainFact.KEEP_GAINS]
    if not reasons_to_keep:
        return dict(axes_by_reason)
    least_sure_reason = min(reasons_to_keep, key=lambda reason: reason.figures["share"])
    # That a rate is sluggish is about one axis, and not about all that are merged.
    common_reason = least_sure_reason.replace(sluggish=None)
    merged_axes: dict[Fact, list[str]] = {}
    for reason, axes in axes_by_reason.items():
        merged_reason = common_reason if reason in reasons_to_keep else reason
        merged_axes.setdefault(merged_reason, []).extend(axes)
    return dict(merged_axes)


def _root_cause(finding: Fact) -> Fact:
    """Returns the finding at which one arrives by asking again and again why a finding on control loops holds.

    For example, no gains are advised since an axis has no loop, and it has none since the vehicle crashed: the root
    cause is the crash.

    Args:
        finding: a reason why gains stay as they are, or a decision on a loop; a coded finding. It may have its reason,
            or several, as a figure.

    Returns:
        The root cause. Of several reasons for one finding the first counts, which is the most important. A finding
        without a reason is its own root cause.
    """
    if finding.code in FINDINGS_WITH_REASONS:
        reason = finding.figures["reasons"][0]
    elif finding.code in FINDINGS_WITH_ONE_REASON:
        reason = finding.figures["reason"]
    else:
        return finding
    return _root_cause(reason)


def _new_gains_fact(axis: str, advice: Advice) -> Fact:
    """Returns the fact with the new gains of an axis, and the lean errors in wind with and without them.

    Args:
        axis: "roll", "pitch" or "yaw".
        advice: the advice on this axis, with new values of parameters.
    """
    changes = []
    for parameter_name, (present_value, new_value) in advice.gains.items():
        changes.append((parameter_name, present_value, new_value))
    return Fact(
        GainFact.GAINS_ADVISED,
        subject=axis,
        changes=changes,
        reason=advice.conclusion,
        expected_error=advice.after.lean_in_wind,
        present_error=advice.before.lean_in_wind,
    )


def _unused_stem(recording: Path, endings: list[str]) -> str:
    """Returns the path for the files of one advice, without their endings; earlier advice is never overwritten.

    Args:
        recording: path of the recording. Its ending is replaced by ``.gains``.
        endings: endings of the files. If one of them exists already, a number is appended to the path.
    """
    first_stem = str(recording.with_suffix(".gains"))
    stem = first_stem
    number = 0
    while any(Path(stem + ending).exists() for ending in endings):
        number += 1
        stem = f"{first_stem}-{number}"
    return stem
