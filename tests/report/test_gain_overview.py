"""The table of gains with which a page of ``mavdem tune`` begins."""

from hover import Hover
from known_gains import ARDUPILOT
from pytest import mark

from mavdem.dataset.signals import Signals
from mavdem.report.blocks import Table
from mavdem.report.gain_changes import GainChanges, NewValue
from mavdem.report.gain_overview import gain_overview

NEW_VALUES = {
    "ATC_RAT_RLL_P": NewValue("0.09"),
    "ATC_ANG_RLL_P": NewValue("6", later_stage=2),
    "ATC_RAT_RLL_D": NewValue("0.002", is_tried=True),
}


def overview(changes):
    """The gains of roll in a log with ArduPilot's parameters."""
    signals = Signals(Hover().telemetry(parameters=ARDUPILOT))
    return gain_overview({"roll": signals}, changes)


def test_new_gains_stand_beside_the_present_ones_and_say_when_they_are_loaded():
    gains = overview(GainChanges((), (), new_values=NEW_VALUES))
    cells = {cell.name: cell for cell in gains.rows["roll"]}
    assert cells["ATC_RAT_RLL_P"].present == f"{ARDUPILOT['ATC_RAT_RLL_P']:.4g}"
    assert [name for name, cell in cells.items() if cell.is_to_be_loaded] == ["ATC_RAT_RLL_P"]
    remarks = {name: cell.remark for name, cell in cells.items() if cell.remark}
    assert remarks == {"ATC_ANG_RLL_P": "stage 2"}
    # What was only tried is no new value.
    assert cells["ATC_RAT_RLL_D"].new is None and cells["ATC_RAT_RLL_I"].new is None


@mark.parametrize(
    "parameters, headers",
    [
        ({"MC_ROLLRATE_P": 0.1, "MC_ROLLRATE_K": 1.2, "MC_ROLL_P": 6.0}, ("P", "K")),
        ({"ATC_RAT_RLL_P": 0.1, "ATC_RAT_RLL_D_FF": 0.01, "ATC_ANG_RLL_P": 4.5}, ("P", "D_FF")),
        # ArduCopter before 3.4.
        ({"RATE_RLL_P": 0.15, "RATE_RLL_I": 0.1, "STB_RLL_P": 4.5}, ("P", "I")),
    ],
)
def test_gains_are_listed_although_other_parameters_of_the_controller_are_missing(
    parameters, headers
):
    signals = Signals(Hover().telemetry(parameters=parameters))
    gains = gain_overview({"roll": signals, "yaw": signals}, None)
    assert gains.headers == (*[f"rate {header}" for header in headers], "angle P")
    (cells,) = gains.rows.values()
    assert {cell.name: cell.present for cell in cells} == {
        name: f"{value:g}" for name, value in parameters.items()
    }


def test_a_gain_that_the_log_does_not_have_has_no_column():
    gains = overview(None)
    assert "ATC_RAT_RLL_FF" not in ARDUPILOT and "rate FF" not in gains.headers
    assert [cell.header for cell in gains.rows["roll"]] == list(gains.headers)
    assert not gains.has_gains_to_load


def test_a_feed_forward_that_is_0_and_stays_0_has_no_column():
    unused = {"ATC_RAT_RLL_P": 0.1, "ATC_RAT_RLL_D": 0.0, "ATC_RAT_RLL_FF": 0.0}
    signals = {"roll": Signals(Hover().telemetry(parameters=unused))}
    gains = gain_overview(signals, None, {"roll": "keep the gains"})
    assert gains.headers == ("rate P", "rate D") and gains.outcomes["roll"] == "keep the gains"
    changes = GainChanges((), (), new_values={"ATC_RAT_RLL_FF": NewValue("0.1")})
    assert "rate FF" in gain_overview(signals, changes).headers


def test_an_axis_that_keeps_its_gains_beside_new_ones_has_them_in_one_sentence():
    parameters = {**ARDUPILOT, "ATC_RAT_YAW_P": 0.2, "ATC_ANG_YAW_P": 4.5}
    signals = {axis: Signals(Hover().telemetry(parameters=parameters)) for axis in ("roll", "yaw")}
    changes = GainChanges((), (), new_values=NEW_VALUES)
    gains = gain_overview(signals, changes, {"yaw": "keep the gains"})
    assert [*gains.table_rows] == ["roll"]
    [sentence] = gains.sentences_on_other_rows
    assert sentence.lead == "Yaw, keep the gains:"
    unknown = gains._replace(outcomes={"yaw": "no gains, margins not known"})
    [sentence_if_unknown] = unknown.sentences_on_other_rows
    assert sentence_if_unknown.lead == "Yaw, no new gains, margins not known:"
    [of_terminal] = gains.sentences_on_axis("yaw")
    assert of_terminal == sentence._replace(lead="Gains of yaw:")
    assert (
        sentence.text.replace("\N{NO-BREAK SPACE}", " ") == "ATC_RAT_YAW_P 0.2, ATC_ANG_YAW_P 4.5."
    )
    # Where no axis has new gains, all have a row.
    kept = gain_overview(signals, None)
    assert kept.table_rows == kept.rows and not kept.sentences_on_other_rows


def test_parameters_that_are_no_gains_have_a_table_of_their_own():
    gain = ["ATC_RAT_RLL_P", "0.135", "0.09", "0.67"]
    notch = ["INS_HNTCH_FREQ", "60", "80", ""]
    table = Table(["gain", "now", "set", "times"], [gain, notch])
    gains = overview(GainChanges((table,), (), new_values=NEW_VALUES))
    assert gains.other_changes.rows == [notch]


def test_without_the_parameters_of_the_controller_there_are_no_gains():
    assert gain_overview({"roll": Signals(Hover().telemetry())}, None) is None
