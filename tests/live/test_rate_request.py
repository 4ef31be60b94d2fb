"""Rates are asked for and given back: what is sent is read by pymavlink, and what was there is never guessed as 0."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import all as dialect

from mavdem.ingest.compose import Sender
from mavdem.ingest.live_messages import Message
from mavdem.live.rate_request import GET_INTERVAL, SET_INTERVAL, STOPPED, RateRequest

VEHICLE = Sender(7, 1)


def told(name: str, first: int, second: int) -> Message:
    return Message(name, 0.0, 0.0, (first, second))


def said(frames: list[bytes]) -> list[tuple[int, int, float]]:
    """Command and first two parameters of each, to the vehicle."""
    parser = dialect.MAVLink(None)
    messages = [message for frame in frames for message in parser.parse_buffer(frame)]
    assert [message.get_type() for message in messages] == ["COMMAND_LONG"] * len(frames)
    assert all((each.target_system, each.target_component) == (7, 1) for each in messages)
    assert all(each.get_srcSystem() == 255 for each in messages)
    return [(each.command, int(each.param1), each.param2) for each in messages]


def test_intervals_are_noted_then_set_and_given_back():
    request = RateRequest(VEHICLE, rate=100.0)
    assert said(request.due(0.0, {})) == [(GET_INTERVAL, 30, 0), (GET_INTERVAL, 36, 0)]
    assert request.due(0.5, {}) == [], "an answer is waited for"
    request.heard(told("MESSAGE_INTERVAL", 30, 250_000))
    request.heard(told("MESSAGE_INTERVAL", 36, STOPPED))
    assert said(request.due(0.6, {})) == [(SET_INTERVAL, 30, 10_000), (SET_INTERVAL, 36, 10_000)]
    request.heard(told("MESSAGE_INTERVAL", 30, 10_000))
    for _ in range(2):
        request.heard(told("COMMAND_ACK", SET_INTERVAL, 0))
    assert request.due(10.0, {}) == [] and request.events == []
    assert said(request.restore()) == [(SET_INTERVAL, 30, 250_000), (SET_INTERVAL, 36, STOPPED)]


def test_a_vehicle_that_tells_no_interval_gets_back_what_was_measured():
    request = RateRequest(VEHICLE, rate=50.0)
    for second in range(3):
        assert {command for command, _, _ in said(request.due(float(second), {30: 4.0}))} == {GET_INTERVAL}
    request.heard(told("MESSAGE_INTERVAL", 30, 0))
    assert said(request.due(3.0, {30: 4.0})) == [(SET_INTERVAL, 30, 20_000), (SET_INTERVAL, 36, 20_000)]
    assert said(request.restore()) == [(SET_INTERVAL, 30, 250_000), (SET_INTERVAL, 36, STOPPED)]


def test_no_answer_and_a_refusal_are_told():
    silent = RateRequest(VEHICLE, rate=50.0, messages=(30,))
    sent = [silent.due(float(second), {}) for second in range(9)]
    assert sum(map(len, sent)) == 6 and "does not answer" in silent.events[0] and len(silent.events) == 1
    refused = RateRequest(VEHICLE, rate=50.0, messages=(375,))
    refused.due(0.0, {})
    refused.heard(told("MESSAGE_INTERVAL", 375, -1))
    refused.due(0.1, {})
    refused.heard(told("COMMAND_ACK", SET_INTERVAL, 4))
    assert "refuses" in refused.events[0] and "375" in refused.events[0]
    assert refused.due(9.0, {}) == []


def settled(rate: float = 100.0) -> RateRequest:
    """A request about one message that came at 4 Hz and now comes as it was asked for."""
    request = RateRequest(VEHICLE, rate, messages=(30,))
    request.due(0.0, {30: 4.0})
    request.heard(told("MESSAGE_INTERVAL", 30, 250_000))
    assert said(request.due(0.1, {30: 4.0})) == [(SET_INTERVAL, 30, 10_000)]
    request.heard(told("COMMAND_ACK", SET_INTERVAL, 0))
    assert request.due(5.0, {30: rate}) == []
    return request


@pytest.mark.parametrize("slow", [{30: 4.0}, {}])
def test_what_was_set_back_is_asked_for_again_and_what_it_was_before_stays_known(slow):
    request = settled()
    assert said(request.due(30.0, slow)) == [(SET_INTERVAL, 30, 10_000)]
    (event,) = request.events
    assert "asked for again" in event
    # Whoever sets it back over and over is not answered each second.
    sent = 0
    for second in range(31, 61):
        request.heard(told("COMMAND_ACK", SET_INTERVAL, 0))
        sent += len(request.due(float(second), slow))
    assert sent <= 3
    assert said(request.restore()) == [(SET_INTERVAL, 30, 250_000)]


def test_what_merely_falters_or_was_never_reached_is_not_asked_for_again():
    request = settled()
    assert [request.due(float(second), {30: 80.0}) for second in range(6, 60)] == [[]] * 54
    slow = RateRequest(VEHICLE, 400.0, messages=(30,))
    slow.due(0.0, {30: 4.0})
    slow.heard(told("MESSAGE_INTERVAL", 30, 250_000))
    slow.due(0.1, {30: 4.0})
    slow.heard(told("COMMAND_ACK", SET_INTERVAL, 0))
    assert [slow.due(float(second), {30: 50.0}) for second in range(1, 60)] == [[]] * 59


def test_what_was_restored_is_confirmed():
    request = settled()
    assert request.restore() and request.restore(), "as often as need be"
    request.heard(told("COMMAND_ACK", SET_INTERVAL, 0))
    assert request.restore() == []


def test_before_anything_was_set_there_is_nothing_to_give_back():
    request = RateRequest(VEHICLE, rate=50.0)
    request.due(0.0, {})
    assert request.restore() == []


@pytest.mark.parametrize("command", [400, GET_INTERVAL])
def test_answers_to_others_change_nothing(command):
    request = RateRequest(VEHICLE, rate=50.0, messages=(30,))
    request.due(0.0, {})
    request.heard(told("COMMAND_ACK", command, 4))
    assert request.events == [] and said(request.due(2.0, {}))
