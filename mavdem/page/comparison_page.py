"""The pages of a comparison and of a choice of the model order."""

from __future__ import annotations

from collections.abc import Sequence

from mavdem.dem.order.choice import OrderChoice
from mavdem.evaluate.comparison import Comparison
from mavdem.page.document import Chapter, render_page
from mavdem.page.pictures import PicturePlan, picture_chapter
from mavdem.report.blocks import Table
from mavdem.report.comparison import comparison_report
from mavdem.report.names import listed
from mavdem.report.order import order_report


def comparison_page(comparison: Comparison, from_zero: bool = False) -> str:
    """The HTML of a comparison; ``from_zero``: forecasts start from state 0."""

    def plans() -> list[PicturePlan]:
        from mavdem.plot.comparisons import error_growth, error_ratios

        growth = PicturePlan(
            "Errors by horizon",
            "The median error ratio by the number of steps that are forecast from one state, of each kind of method "
            "the best. Below 1 a forecast is better than the constant mean.",
            lambda: error_growth(comparison),
        )
        windows = PicturePlan(
            "Errors in every window",
            "Each dot is one window, each bar the median of a method. Dots at an edge are beyond it.",
            lambda: error_ratios(comparison, from_zero),
        )
        return [windows] if from_zero else [windows, growth]

    blocks = comparison_report(comparison, from_zero)
    first = next(place for place, block in enumerate(blocks) if isinstance(block, Table))
    return render_page(
        "DEM and other methods",
        f"Forecasts of the same windows of {listed(comparison.flights)}.",
        blocks[:first],
        [picture_chapter(plans), Chapter("All errors", blocks[first:])],
    )


def order_page(choice: OrderChoice, names: Sequence[str]) -> str:
    """The HTML of a choice of the model order; ``names`` are those of its flights."""

    def plans() -> list[PicturePlan]:
        from mavdem.plot.comparisons import free_energy_by_order

        caption = "How far F̄ is below its highest value. In the shaded part the difference is no strong evidence."
        return [PicturePlan("Free energy by order", caption, lambda: free_energy_by_order(choice, names))]

    return render_page(
        "Model order",
        f"The number of states that {listed(names)} show{'s' * (len(names) == 1)}, by the free energy.",
        order_report(choice, names),
        [picture_chapter(plans)],
    )
