"""Watches a live flight for a motor that loses thrust slowly, by the search that logs are judged by, once a second.

A loss that takes ten seconds or more moves the reference of the sequential test along (``mavdem.motors.gradual_loss``),
which then finds it late, and only the part of it that is new.
"""

from collections import deque
from math import inf, nan

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.containers import Numbers
from mavdem.ingest.motors import MotorGeometry
from mavdem.motors.balance import MAX_GAP
from mavdem.motors.balance_blocks import UNKNOWN_LEAN, BlockAverager, CommandBlock
from mavdem.motors.gradual_loss import MAX_BLOCKS, MIN_BEFORE_SECONDS, gradual_loss
from mavdem.motors.loss_confirmation import HALF_CHANGE, MAX_CONFIRMATION_SECONDS
from mavdem.motors.motor_changes import MIN_LOSS_SECONDS, MotorChange

SEARCH_PERIOD = 1.0
"""Time between two searches, s: a choice; one takes some milliseconds."""

STEADY_HEADING = 0.0
"""Heading, rad, that all samples get, as only those are taken whose attitude follows its setpoint."""


class GradualLossWatch:
    """Searches the settled flight so far, two minutes at most, for a motor that lost thrust slowly.

    The search needs flight in which the motor was sound. Two minutes after the loss none of it is kept, and the search
    no longer finds a motor that is still weak. So a loss is over only if the command of the motor has fallen too.

    Attributes:
        loss: the loss as of the latest search that found it; None without one.
    """

    def __init__(self, geometry: MotorGeometry, boot: int) -> None:
        """Begins the search for a slow loss of thrust, without a sample.

        Args:
            geometry: positions and spins of the k motors.
            boot: number of the boot.
        """
        self.loss: MotorChange | None = None
        self._geometry = geometry
        self._boot = boot
        self._averager = BlockAverager()
        self._blocks: deque[CommandBlock] = deque(maxlen=MAX_BLOCKS)
        self._latest_time = -inf
        self._search_time = -inf
        # When the loss was found last, s.
        self._found_time = -inf
        # Commands of the weak motor, relative to the mean command of all motors: the first before the loss, and the
        # second at the time of the latest search that found the loss.
        self._sound_command = nan
        self._weak_command = nan

    def is_continued(self, time: float) -> bool:
        """Returns whether a sample at a time, s of the boot clock, continues the flight so far, without a long gap."""
        return 0 < time - self._latest_time < MAX_GAP

    def restart(self) -> None:
        """Forgets the flight so far: it is no reference for later flight, as after a sudden change or a landing."""
        self.loss = None
        self._blocks.clear()
        self._latest_time = -inf

    def add_sample(self, time: float, commands: list[float], lean: Numbers = UNKNOWN_LEAN) -> None:
        """Adds a sample of settled flight, and searches, when that is due, for a motor that gradually loses thrust.

        A loss that was found is over if no search has found it for ``MAX_CONFIRMATION_SECONDS``, and if the command of
        the motor in this time was nearer to its value before the loss than to its value with the loss.

        Args:
            time: time of the sample, in which the attitude follows its setpoint, s of the boot clock.
            commands: (k,) outputs of the motors, as fractions of the range.
            lean: roll and pitch, rad; NaN where they are not known.
        """
        if not self.is_continued(time):
            self.restart()
            self._averager.restart(time, STEADY_HEADING)
        self._latest_time = time
        completed_block = self._averager.add(time, commands, STEADY_HEADING, lean)
        if completed_block is None:
            return
        self._blocks.append(completed_block)
        is_search_due = time - self._search_time >= SEARCH_PERIOD
        if is_search_due:
            self._search_time = time
            self._search(time)

    def _search(self, time: float) -> None:
        """Searches the latest two minutes for a motor that loses thrust slowly, and updates ``loss``.

        A loss that is found is new, or confirms the known one. A known loss that is not found is over if the motor has
        recovered (:meth:`_has_recovered`).

        Args:
            time: time of the search, s of the boot clock.
        """
        # Blocks are means over a short time: B blocks of the commands of k motors.
        block_ends = np.array([block.end for block in self._blocks])
        block_commands = np.array([block.commands for block in self._blocks])
        leans = np.array([block.lean for block in self._blocks])
        detected_loss = gradual_loss(block_ends, block_commands, leans, self._geometry, self._boot)
        if detected_loss is not None:
            self._update_loss(detected_loss, block_ends, block_commands)
            self._found_time = time
            return
        has_confirmation_ended = time - self._found_time > MAX_CONFIRMATION_SECONDS
        if self.loss is not None and has_confirmation_ended:
            # The search finds only changes within the two minutes, and not a loss that has lasted for all of them. So
            # the command of the motor decides whether the loss is over.
            is_recent = block_ends > time - MAX_CONFIRMATION_SECONDS
            recent_command = self._relative_command(self.loss, block_commands, is_recent)
            if self._has_recovered(recent_command):
                self.loss = None

    def _has_recovered(self, recent_command: float) -> bool:
        """Returns whether the weak motor's command is nearer to the one before its loss than to the one with the loss.

        A motor that lost thrust needs a higher command than before for the same thrust.

        Args:
            recent_command: its command in the last seconds, relative to the mean command of all motors.
        """
        rise_by_loss = self._weak_command - self._sound_command
        recent_rise = recent_command - self._sound_command
        return recent_rise < HALF_CHANGE * rise_by_loss

    def _update_loss(self, loss: MotorChange, block_ends: Array, block_commands: Array) -> None:
        """Updates the known loss and the commands of its motor by the loss that the latest search has found.

        The search sees only the latest two minutes. If the motor was weak in all of them, the search finds the growth
        of the loss in this time, and not the whole loss. Such a loss replaces the known one only if it is larger.

        Args:
            loss: the loss that the search has found.
            block_ends: (B,) ends of the blocks that were searched, s of the boot clock.
            block_commands: (B, k) mean commands of the k motors in these blocks, as fractions of the range.
        """
        known_loss = self.loss
        if known_loss is None or known_loss.name != loss.name:
            is_before = block_ends <= loss.onset_time
            self._sound_command = self._relative_command(loss, block_commands, is_before)
            self.loss = loss
        else:
            has_sound_flight = block_ends[0] <= known_loss.onset_time - MIN_BEFORE_SECONDS
            if has_sound_flight or loss.size > known_loss.size:
                self.loss = loss
        is_recent = block_ends > block_ends[-1] - MIN_LOSS_SECONDS
        self._weak_command = self._relative_command(loss, block_commands, is_recent)

    def _relative_command(
        self, loss: MotorChange, block_commands: Array, is_selected: Flags
    ) -> float:
        """Returns the mean command of the weak motor in some blocks, relative to the mean command of all motors.

        Args:
            loss: the loss of the motor.
            block_commands: (B, k) mean commands of the blocks.
            is_selected: (B,) the blocks that count.
        """
        weak_motor = self._geometry.names.index(loss.name)
        selected_commands = block_commands[is_selected]
        mean_of_motors = selected_commands.mean(axis=1)
        relative_commands = selected_commands[:, weak_motor] / mean_of_motors
        return float(relative_commands.mean())
