"""Meanings of parameters: by their whole name, and for what differs from the default in a table of their own."""

from pytest import mark

from mavdem.ingest.telemetry import Telemetry
from mavdem.report.pages.page import render_document
from mavdem.report.pages.parameter_chapter import (
    MEANINGS,
    meaning_of,
    parameters_chapter,
    reference_address,
)


@mark.parametrize(
    "name, words",
    [
        ("ATC_RAT_RLL_P", "proportional"),
        ("MC_PITCHRATE_D", "derivative"),
        ("INS_HNTC2_FREQ", "notch"),
        ("BAT1_N_CELLS", "cells"),
        ("LOG_BITMASK", "logged"),
        ("MPC_THR_MIN", "least"),
        # The group of a parameter is no meaning, and no pattern fits a part of a name alone.
        ("MPC_VELD_LP", ""),
        ("XMC_ROLL_P", ""),
        ("MC_ROLL_PX", ""),
    ],
)
def test_a_parameter_is_known_by_its_whole_name(name, words):
    meaning = meaning_of(name)
    assert words in meaning
    assert bool(meaning) == bool(words)


def test_meanings_are_a_few_words_without_a_full_stop():
    assert all(0 < len(meaning) < 90 and meaning[-1] != "." for meaning in MEANINGS.values())


def test_what_differs_from_the_default_is_listed_with_its_meaning():
    """The log has the default values too.

    Parameters that differ from them are listed with meaning and link; FRAME_TYPE, which equals its default, is not.
    """
    telemetry = Telemetry(
        system=1,
        component=1,
        vehicle="QUADROTOR",
        autopilot="ARDUPILOTMEGA",
        messages={},
        parameters={
            "ATC_RAT_RLL_P": 0.2,
            "BATT_LOW_TIMER": 5.0,
            "FRAME_TYPE": 1.0,
            "XYZZY": 3.0,
        },
        default_parameters={
            "ATC_RAT_RLL_P": 0.135,
            "BATT_LOW_TIMER": 10.0,
            "FRAME_TYPE": 1.0,
            "XYZZY": 1.0,
        },
    )
    chapter = parameters_chapter(telemetry, is_full=True)
    table = chapter.blocks[-1]
    assert table.header[0] == "not the default"
    assert table.rows == [
        ["ATC_RAT_RLL_P", "0.2", "0.135", "rate controller: proportional gain"],
        # Values have their unit.
        [
            "BATT_LOW_TIMER",
            "5 s",
            "10 s",
            "how long the voltage must be low before the battery is low",
        ],
        ["XYZZY", "3", "1", ""],
    ]
    # The table of control parameters, which logs without defaults have too, links as well.
    assert chapter.blocks[0].rows == [["ATC_RAT_RLL_P", "0.2", "", ""]]
    assert chapter.blocks[0].rows[0][0].address.endswith("#atc-rat-rll-p")
    addresses = [row[0].address for row in table.rows]
    reference = "https://ardupilot.org/copter/docs/parameters.html"
    assert addresses == [
        f"{reference}#{name}" for name in ("atc-rat-rll-p", "batt-low-timer", "xyzzy")
    ]
    # A long name may break after each underscore.
    page = render_document("a.bin", "", [], [chapter]).replace("<wbr>", "")
    assert f'<a href="{addresses[0]}" rel="noreferrer">ATC_RAT_RLL_P</a>' in page
    assert [row[0] for row in chapter.searchable.rows] == [*telemetry.parameters]
    small = parameters_chapter(telemetry, is_full=False)
    assert small.searchable is None
    assert len(small.blocks) == len(chapter.blocks) - 2


def test_a_parameter_is_described_by_the_makers_of_its_autopilot():
    assert reference_address("PX4", "MC_ROLL_P").endswith("/parameter_reference#MC_ROLL_P")
    assert reference_address("GENERIC", "MC_ROLL_P") == ""
