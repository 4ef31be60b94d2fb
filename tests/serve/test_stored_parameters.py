"""All parameters of a flight, stored with its results."""

from pytest import mark

from mavdem.serve.stored_files import PARAMETERS_FILE
from mavdem.serve.stored_parameters import read_parameters, write_parameters


def test_stored_parameters_are_read_as_they_were_written(tmp_path):
    parameters = {"ATC_RAT_RLL_P": 0.135, "LOG_BITMASK": 180222.0}
    write_parameters(tmp_path, parameters)
    assert read_parameters(tmp_path) == parameters


@mark.parametrize(
    "text",
    [
        "",
        "[1]",
        '{"A": "abc"}',
        '{"A": null}',
        '{"A": true}',
        '{"A": Infinity}',
        f'{{"A": 1{"0" * 400}}}',
        "[" * 100_000,
    ],
    ids=["empty", "list", "text", "null", "true", "infinite", "too large", "deep"],
)
def test_damaged_parameters_are_none(tmp_path, text):
    (tmp_path / PARAMETERS_FILE).write_text(text)
    assert read_parameters(tmp_path) is None
