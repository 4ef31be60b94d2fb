"""The page of two flights compared: its charts show the figures that its text compares."""

from numpy.testing import assert_allclose

from mavdem.report.pages.difference_page import _trim_chart


def test_the_chart_of_trims_shows_the_changes_that_are_compared():
    # Motor 2 changes by 10 % beside motors of which none moves: beside their mean it would be 7.3 %.
    documents = {}
    for side, shares in {"A": [1.0, 1.0, 1.0, 1.0], "B": [0.9756, 1.0732, 0.9756, 0.9756]}.items():
        documents[side] = {
            "condition": {"hover": {"trim_share": shares}, "share_interval": [0.01] * 4}
        }
    chart = _trim_chart(documents, {"A": "first", "B": "second"})
    before, after = chart.lines
    assert_allclose(after.y - before.y, [0.0, 9.5, 0.0, 0.0], atol=0.1)
