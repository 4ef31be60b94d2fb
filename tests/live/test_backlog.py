"""The queue of frames: what it puts off, and when the process that learns is stopped."""

from mavdem.facts.session import SessionFact
from mavdem.live.backlog import STEP_SECONDS, SUSPENSION_DELAY, Backlog
from mavdem.live.intake import FrameBatch


def test_learning_is_suspended_until_the_analysis_has_caught_up(monkeypatch):
    """Frames that wait for more than ``SUSPENSION_DELAY`` suspend learning, until they wait for less than one step."""
    now = [100.0]
    monkeypatch.setattr("mavdem.live.clock.monotonic", lambda: now[0])
    backlog = Backlog()
    suspended = []
    for delay in (
        0.5 * SUSPENSION_DELAY,
        1.1 * SUSPENSION_DELAY,
        2 * STEP_SECONDS,
        0.5 * STEP_SECONDS,
    ):
        now[0] += 10.0
        backlog.add([FrameBatch(now[0] - delay, 0.0, [])])
        backlog.update(0)
        suspended.append(backlog.suspends_learning)
        backlog.pop_simultaneous()
    assert suspended == [False, True, True, False]
    assert not backlog.postponed_tasks


def test_alarms_are_late_at_once_and_until_the_delay_was_short_for_seconds(monkeypatch):
    """Each delay lasts for a second. One of 3 s counts at once; below that alarms stay late, until 30 s below 1.5 s."""
    now = [100.0]
    monkeypatch.setattr("mavdem.live.clock.monotonic", lambda: now[0])
    backlog = Backlog()
    alarm_delays = []
    for delay in (2.9, 3.1, 0.2, 0.2, 2.0, *[0.2] * 31):
        backlog.add([FrameBatch(now[0] - delay, 0.0, [])])
        backlog.update(0)
        backlog.pop_simultaneous()
        alarm_delays.append(round(backlog.alarm_delay.seconds, 6))
        now[0] += 1.0
    assert alarm_delays == [0.0, *[3.1] * 31, *[2.0] * 3, 0.0]


def test_what_still_waits_in_the_link_is_not_analysed(monkeypatch):
    """The analysis keeps up with what is received, while a flood of messages waits in the link for 3 s."""
    monkeypatch.setattr("mavdem.live.clock.monotonic", lambda: 100.0)
    backlog = Backlog()
    analysed_until = []
    for is_link_empty in (False, True):
        backlog.add([FrameBatch(97.0, 0.0, [])], is_link_empty=is_link_empty)
        backlog.pop_simultaneous()
        analysed_until.append(backlog.analysed_until)
    assert analysed_until == [97.0, 100.0]


def test_a_session_that_begins_late_is_too_slow_only_where_it_does_not_catch_up(monkeypatch):
    """One session catches up after a late start. Another stays 1.2 s late, which is reported after 10 s."""
    now = [100.0]
    monkeypatch.setattr("mavdem.live.clock.monotonic", lambda: now[0])
    reported = []
    for delays in ([1.2, 0.5, 0.0], [1.2] * 13):
        backlog = Backlog(begins_late=True)
        for delay in delays:
            backlog.add([FrameBatch(now[0] - delay, 0.0, [])])
            reported.append(backlog.update(0))
            backlog.pop_simultaneous()
            now[0] += 1.0
    (fact,) = filter(None, reported)
    assert fact.code is SessionFact.COMPUTER_BEHIND and reported.index(fact) == 3 + 10


def test_a_delay_that_doubles_is_reported_again(monkeypatch):
    """The computer falls behind by 1 s each second.

    A delay of 1 s is reported, and then each time that it has doubled.
    """
    now = [100.0]
    monkeypatch.setattr("mavdem.live.clock.monotonic", lambda: now[0])
    backlog = Backlog()
    backlog.add([FrameBatch(now[0], 0.0, [])])
    reported = []
    for _ in range(130):
        now[0] += 1.0
        fact = backlog.update(0)
        if fact is not None:
            assert fact.code is SessionFact.COMPUTER_BEHIND
            reported.append(fact.figures["delay"])
    assert reported == [1.0, 31.0, 62.0, 124.0]


def test_silence_does_not_show_that_the_computer_keeps_up(monkeypatch):
    """The computer is two seconds behind when the messages cease.

    Only messages that are processed without delay report that it keeps up.
    """
    now = [100.0]
    monkeypatch.setattr("mavdem.live.clock.monotonic", lambda: now[0])
    backlog = Backlog()
    reported = []

    def pass_seconds(count, delay=None):
        for _ in range(count):
            now[0] += 1.0
            if delay is not None:
                backlog.add([FrameBatch(now[0] - delay, 0.0, [])])
            reported.append(backlog.update(0))
            if delay is not None:
                backlog.pop_simultaneous()

    pass_seconds(1, delay=2.0)
    pass_seconds(100)
    assert [fact.code for fact in filter(None, reported)] == [SessionFact.COMPUTER_BEHIND]
    pass_seconds(40, delay=0.0)
    assert [fact.code for fact in filter(None, reported[101:])] == [SessionFact.COMPUTER_KEEPS_UP]
