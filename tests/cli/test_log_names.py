"""A log in the place of the command's name: its ending is enough."""

from command_line import refused
from pytest import mark

from mavdem.cli.commands import looks_like_log_name


@mark.parametrize("name", ["a.zip", "a.BIN", "a.ulg.xz", "a.ulge", "a.px4log", "a.log", "a.mcap"])
def test_the_ending_of_a_log_stands_for_its_review(name):
    assert looks_like_log_name(name)


@mark.parametrize("name", ["zip", "reviw", "a.csv", "a.params"])
def test_a_word_that_is_no_file_name_of_a_log_is_not_taken_for_one(name):
    assert not looks_like_log_name(name)


def test_a_log_whose_name_begins_with_a_hyphen_stands_behind_two(capsys):
    assert "-gone.tlog does not exist" in refused(capsys, 2, "--", "-gone.tlog")
