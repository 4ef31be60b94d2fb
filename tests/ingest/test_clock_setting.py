"""A clock that is set while a ROS 2 recording runs is joined; a restart is not."""

import numpy as np
from pytest import approx, mark

from mavdem.facts.sources import Repair
from mavdem.ingest.ros2.clock_setting import with_joined_clocks

START = 1_700_000_000 * 10**9
SECOND = 10**9


def recorded(offsets, silence=0.0, count=300, step=0.02):
    """Records two topics alternately while the clock of the vehicle is set.

    At half of the messages the offset of its clock, s, changes, after a silence, s. Returns stamps and positions of the
    messages by topic, and the times of their reception by position.
    """
    rows = np.arange(count)
    is_after = rows >= count // 2
    sent = 100.0 + step * rows + silence * is_after
    received = {row: round(START + (sent[row] + 0.003) * SECOND) for row in rows.tolist()}
    stamps = np.array([round((sent[row] + offsets[int(is_after[row])]) * SECOND) for row in rows])
    positions = {"attitude": rows[::2], "motors": rows[1::2]}
    return {name: stamps[of_topic] for name, of_topic in positions.items()}, positions, received


@mark.parametrize("change", [1.7e9, -60.0, 600.0])
def test_a_clock_that_is_set_goes_on(change):
    stamps, positions, received = recorded((0.0, change))
    joined, repairs = with_joined_clocks(stamps, positions, received)
    assert [repair.code for repair in repairs] == [Repair.CLOCK_SET]
    for topic_stamps in joined.values():
        assert (np.diff(topic_stamps) / SECOND).tolist() == approx([0.04] * 149, abs=1e-3)


def test_a_message_that_is_recorded_after_the_setting_keeps_its_time():
    stamps, positions, received = recorded((0.0, 1.7e9))
    late = stamps["motors"].copy()
    late[76] = stamps["motors"][74] + 80_000_000
    joined, _ = with_joined_clocks(stamps | {"motors": late}, positions, received)
    assert joined["motors"][76] == late[76]


@mark.parametrize(("change", "silence"), [(-95.0, 8.0), (300.0, 60.0), (-100.0, 1.0)])
def test_after_a_silence_it_is_another_boot(change, silence):
    stamps, positions, received = recorded((0.0, change), silence)
    joined, repairs = with_joined_clocks(stamps, positions, received)
    assert repairs == ()
    assert joined["attitude"].tolist() == stamps["attitude"].tolist()


def test_single_wrong_stamps_change_nothing():
    stamps, positions, received = recorded((0.0, 0.0))
    stamps["motors"][40] += 500 * SECOND
    joined, repairs = with_joined_clocks(stamps, positions, received)
    assert repairs == ()
    assert joined["motors"].tolist() == stamps["motors"].tolist()
