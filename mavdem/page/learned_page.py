"""The page of a learnt flight: the screen's report, pictures, and in folded chapters what was read and how."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from mavdem.condition.hover import HoverFigures
from mavdem.dem import Learned, Settings
from mavdem.evaluate.held_out import HeldOut
from mavdem.page.document import Chapter, render_page
from mavdem.page.pictures import PicturePlan, picture_chapter
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.log_contents import log_blocks
from mavdem.report.names import Labels
from mavdem.report.screen import key_figures


def learned_page(
    heading: Sentence,
    blocks: Sequence[Block],
    details: Sequence[Block],
    learned: Learned,
    held_out: HeldOut,
    hover: HoverFigures | None,
    held: dict[str, Any],
) -> str:
    """The HTML of a learnt flight.

    Args:
        heading: which log, and what of it.
        blocks: the report on the screen.
        details: what the screen leaves out.
        learned: the model.
        held_out: windows that no model saw which forecasts them.
        hover: how hard each motor works, where that is known.
        held: the log's inventory, of ``mavdem.condition.inventory``.
    """
    return render_page(
        heading.lead.rstrip(":"),
        heading.text[:1].upper() + heading.text[1:],
        blocks,
        [
            picture_chapter(lambda: _plans(learned, held_out, hover)),
            Chapter("The model, and how it was learnt", details, folded=True),
            Chapter("What was read from the log, and repaired", log_blocks(held), folded=True),
            Chapter("Settings", [settings_table(learned.settings)], folded=True),
        ],
        key_figures(learned, held_out),
    )


def settings_table(settings: Settings) -> Table:
    """Every setting by name; ``mavdem.Settings`` says what each means."""
    return Table(["setting", "value"], [[name, str(value)] for name, value in asdict(settings).items()], words=True)


def _plans(learned: Learned, held_out: HeldOut, hover: HoverFigures | None) -> list[PicturePlan]:
    from mavdem import plot

    labels = Labels.of(learned)
    first, *others = labels.output_names
    forecasts = [
        PicturePlan(
            f"Forecast of {first}",
            "Windows that no model saw which forecasts them, each from what came before it, with the motors as "
            "recorded. Shown in full are neighbours with errors near the median. Below, if there are more, the error "
            "of each window.",
            lambda: plot.forecast(held_out, labels),
        ),
        *(
            PicturePlan(f"Forecast of {name}", f"The same of {name}.", partial(plot.forecast, held_out, labels, place))
            for place, name in enumerate(others, 1)
        ),
    ]
    return [
        *forecasts,
        PicturePlan(
            "Wind's torque",
            "Angular acceleration by neither the motors nor the damping, with its 90 % band; gusts are marked. Below, "
            "its spectrum.",
            lambda: plot.disturbance(learned),
        ),
        *model_plans(learned, hover),
        PicturePlan(
            "Residuals",
            "Errors one step ahead in the training data; what of them their past and the command would still "
            "predict. Inside the shaded bounds that may be chance.",
            lambda: plot.residuals(learned),
        ),
        PicturePlan(
            "Learning",
            "The free energy action F̄, its terms and the parameters by iteration.",
            lambda: plot.learning(learned),
        ),
    ]


def model_plans(learned: Learned, hover: HoverFigures | None = None) -> list[PicturePlan]:
    """The pictures of a model by itself; ``hover`` is how hard each motor works."""
    from mavdem import plot

    return [
        PicturePlan(
            "Motors",
            "The effect of each motor with its 90 % interval, and how hard each works where that is known.",
            lambda: plot.motors(learned, hover),
        ),
        PicturePlan(
            "Frequency response",
            "From the command of the axis to its rate (Bode plot), with a 90 % band at each frequency.",
            lambda: plot.bode(learned),
        ),
        PicturePlan(
            "Step response",
            "After a step of the command, with a 90 % band at each time. Where the two differ, closed loop biases the "
            "model's A and B: the physical parameters are what the vehicle does.",
            lambda: plot.step(learned),
        ),
        PicturePlan(
            "Poles",
            "Of model and physical parameters with the motors as inputs, without the autopilot; left of 0 is stable.",
            lambda: plot.poles(learned),
        ),
    ]
