"""Watches in flight whether lasting shifts of the trims are beyond what the vehicle's lean against the wind explains.

They are judged by the function that logs are judged by, with the settled flight so far. A shift is judged again as the
flight goes on: soon after it, little flight shows what the lean explains.
"""

from collections.abc import Sequence
from math import inf

import numpy as np

from mavdem.containers import Numbers
from mavdem.dataset.intervals import TimeInterval
from mavdem.ingest.motors import MotorGeometry
from mavdem.motors.balance import BLOCK_SECONDS, MAX_GAP, SteadyRun
from mavdem.motors.balance_blocks import BlockAverager, CommandBlock
from mavdem.motors.lean_check import without_shifts_by_lean
from mavdem.motors.motor_changes import MotorChange, lasting_changes
from mavdem.motors.signatures import motor_signatures

JUDGING_PERIOD = BLOCK_SECONDS
"""Time between two judgements of the same shifts, s: a shorter time adds no block to the fit."""

ANY_HEADING = 0.0
"""Heading, rad, that all samples get, since the fit uses turns like other flight."""


class LeanWatch:
    """Keeps the settled flight of one vehicle so far, and judges the shifts of its trims by it."""

    def __init__(self, geometry: MotorGeometry) -> None:
        """Begins without flight.

        Args:
            geometry: positions and spins of the k motors.
        """
        self._signatures = motor_signatures(geometry)
        self._averager = BlockAverager()
        # Means of the samples, in runs without a gap of ``MAX_GAP``.
        self._runs: list[list[CommandBlock]] = []
        self._latest_time = -inf
        self._judging_time = -inf
        # The lasting changes at the latest judgement, and the shifts among them that lean does not explain.
        self._judged_changes: list[MotorChange] = []
        self._unexplained_shifts: list[MotorChange] = []

    def add_sample(self, time: float, commands: Sequence[float], lean: Numbers) -> None:
        """Adds a sample of settled flight.

        Args:
            time: time of the sample, s of the boot clock.
            commands: (k,) outputs of the motors, as fractions of the range.
            lean: roll and pitch, rad; NaN where they are not known.
        """
        is_continued = 0 < time - self._latest_time < MAX_GAP
        if not is_continued:
            self._averager.restart(time, ANY_HEADING)
            self._runs.append([])
        self._latest_time = time
        completed_block = self._averager.add(time, commands, ANY_HEADING, lean)
        if completed_block is not None:
            self._runs[-1].append(completed_block)

    def withdraw_since(self, time: float) -> None:
        """Forgets the flight since a time, s of the boot clock, which turned out to be a landing or a loss."""
        self._runs = [[block for block in run if block.end <= time] for run in self._runs]
        self._judging_time = -inf

    def unexplained_shifts(self, changes: Sequence[MotorChange]) -> list[MotorChange]:
        """Returns the lasting shifts of the trims that are beyond the lean, by the settled flight so far.

        Args:
            changes: all changes of the motors' balance in this flight, in the order of time. Those that name a motor
                limit the flight by which a shift beside them is judged.

        Returns:
            The shifts, which name no motor, in the same order. They are judged at most once in ``JUDGING_PERIOD``.
        """
        present_changes = lasting_changes(changes)
        if all(change.motor is not None for change in present_changes):
            return []
        is_due = self._latest_time - self._judging_time >= JUDGING_PERIOD
        if is_due or present_changes != self._judged_changes:
            self._judge(present_changes)
        return self._unexplained_shifts

    def _judge(self, lasting: list[MotorChange]) -> None:
        """Judges the shifts among the lasting changes of this flight, and stores those that lean does not explain."""
        self._judging_time = self._latest_time
        self._judged_changes = lasting
        remaining = without_shifts_by_lean(lasting, self._signatures, self._run_around)
        self._unexplained_shifts = [change for change in remaining if change.motor is None]

    def _run_around(self, change: MotorChange, interval: TimeInterval) -> SteadyRun | None:
        """Returns the settled flight around a change, limited to an interval, s since boot; None without any.

        Args:
            change: the change, whose onset the run must contain.
            interval: the interval, in which nothing else changed.
        """
        start, end = interval
        for run in self._runs:
            if run and run[0].end <= change.onset_time <= run[-1].end:
                blocks = [block for block in run if start <= block.end <= end]
                return SteadyRun(
                    time=np.array([block.end for block in blocks]),
                    commands=np.array([block.commands for block in blocks]),
                    lean=np.array([block.lean for block in blocks]),
                )
        return None
