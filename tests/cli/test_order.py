"""`mavdem order`: the table, the document, and flights that do not tell."""

import json

import numpy as np
import pytest
from command_line import FLIGHT, SLOW

from mavdem.cli.commands import main


@pytest.mark.slow
def test_the_order_and_why_are_reported(tmp_path, capsys):
    page = tmp_path / "order.html"
    assert main(["order", str(FLIGHT), str(SLOW), "--max-order", "3", "--html", str(page), "--json"]) == 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert document["html"] == str(page) and "ardupilot_wind5_steps" in page.read_text()
    assert document["flights"] == ["ardupilot_wind5_steps"]
    heights = np.array(document["free_energy"][0])
    assert document["orders"] == [1, 2, 3] and np.isfinite(heights).all()
    # No order above the chosen one gains three nats, and the one below it loses more.
    assert (heights[document["chosen"] :] <= heights[document["chosen"] - 1] + 3).all()
    assert document["chosen"] == 1 or heights[document["chosen"] - 2] < heights[document["chosen"] - 1] - 3
    assert [one["flight"] for one in document["refused"]] == ["ardupilot_default_rates"]
    assert "no order" in err


def test_a_flight_that_cannot_tell_ends_with_one(capsys):
    assert main(["order", str(SLOW)]) == 1
    out, err = capsys.readouterr()
    assert not out and "4" in err
