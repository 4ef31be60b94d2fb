"""A log in the place of the command's name: a dot, a colon or a slash is enough."""

from command_line import refused
from pytest import mark

from mavdem.cli.commands import looks_like_source


@mark.parametrize("name", ["a.zip", "a.bln", "logs/a", "udpin:127.0.0.1:14550", "https://x"])
def test_what_may_be_a_log_or_a_link_stands_for_its_review(name):
    assert looks_like_source(name)


@mark.parametrize("name", ["zip", "reviw"])
def test_a_word_is_a_command(name):
    assert not looks_like_source(name)


def test_a_log_whose_name_begins_with_a_hyphen_stands_behind_two(capsys):
    assert "-gone.tlog does not exist" in refused(capsys, 2, "--", "-gone.tlog")
