"""Advice at landing: the gains that ``mavdem tune`` advises on the recording of a session, by a process of its own.

That process has low priority, begins when the vehicle has landed and ends with its advice. Nothing is sent.
"""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import ExitStack
from itertools import count
from pathlib import Path

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.assessment.axis.tuning import tuned
from mavdem.assessment.axis.twin import predicted_errors
from mavdem.dataset.axes import AXES
from mavdem.errors import Refusal
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import Gains
from mavdem.ingest import read_log
from mavdem.ingest.parameter_file import parameter_files


class GainAdviser:
    """Has advice made on a growing ``recording`` by executors that ``start`` starts.

    ``facts`` are the latest: which gains, what to expect of them, and the files, or why there are none. ``is_due`` is
    set where the vehicle has landed.
    """

    def __init__(self, recording: Path, start: Callable[[], Executor]) -> None:
        self.facts: Facts = ()
        self.is_due = False
        self._recording = recording
        self._start = start
        self._process = ExitStack()
        self._making: Future[Facts] | None = None

    def go_on(self, vehicle: str, is_busy: bool, at_end: bool) -> Facts:
        """Begins what is due, unless the computer ``is_busy``; returns the facts of what is made, once.

        ``at_end`` it waits for that, half a minute at most.
        """
        if self.is_due and is_busy and not at_end:
            return (Fact(Gains.ADVICE_WAITS),)
        if self.is_due:
            self.is_due = False
            self.close()
            executor = self._process.enter_context(self._start())
            self._making = executor.submit(advised, self._recording, vehicle)
        if self._making is None or not (at_end or self._making.done()):
            return ()
        try:
            self.facts = self._making.result(30.0)  # s: a vehicle's user waits for no more
        except Exception as error:
            self.facts = (Fact(Gains.ADVICE_FAILED, error=error, path=str(self._recording)),)
        self.close()
        return self.facts

    def close(self) -> None:
        """Ends the process, whatever it computes."""
        self._making = None
        self._process.close()


def advised(recording: Path, vehicle: str) -> Facts:
    """Returns the advice on all axes of a ``vehicle`` in a recording, as ``mavdem tune`` makes it, and what it does.

    Writes the gains into new files beside the recording, for the ground stations that ``mavdem tune`` writes for.
    Raises OSError: they cannot be written.
    """
    try:
        assessment = assess(read_log(recording), vehicle, AXES[0], Options(with_model=False))
        assert assessment.evidence is not None
        tuning = tuned(assessment, AXES, is_written=True)
    except Refusal as error:
        return (Fact(Gains.GAINS_LEFT, because=error.fact),)
    facts = [
        Fact(
            Gains.GAINS_ADVISED,
            subject=advice.before.axis,
            changes=[(name, *gain) for name, gain in advice.gains.items()],
            because=advice.sentence,
            expected_error=advice.after.lean_in_wind,
            present_error=advice.before.lean_in_wind,
        )
        for advice in tuning.advice
        if advice.parameters
    ]
    if not facts:
        least = min(tuning.advice, key=lambda advice: advice.sure)
        return (Fact(Gains.GAINS_LEFT, subject=least.before.axis, because=least.sentence),)
    facts += predicted_errors(assessment.evidence, tuning.parameters)
    files = parameter_files(tuning.parameters, assessment.evidence.signals.telemetry)
    names = (f"{recording.with_suffix('.gains')}{-number or ''}" for number in count())
    name = next(name for name in names if not any(Path(name + end).exists() for end in files))
    for end, text in files.items():
        Path(name + end).write_text(text)
    return (
        *facts,
        Fact(
            Gains.GAINS_WRITTEN, path=name + " and ".join(files), because=tuning.judgement.next_step
        ),
    )
