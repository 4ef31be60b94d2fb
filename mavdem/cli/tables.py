"""Tables on a terminal: a table of numbers that is too wide is split into several that fit below each other."""

from collections.abc import Iterator
from dataclasses import dataclass

from rich.table import Table as Grid

from mavdem.cli.streams import escape_unprintable
from mavdem.report.blocks import Table, shortened

COLUMN_GAP = 2
"""Characters between two columns: Rich sets one on either side of a cell, and none at the edges of these tables."""


@dataclass(frozen=True)
class Column:
    """One column of a table, as text that a terminal can show."""

    heading: str
    """Heading, which may wrap between its words."""

    cells: list[str]
    """Text of each row."""

    @property
    def full_width(self) -> int:
        """Characters that the column takes if its heading is on one line."""
        return max(len(text) for text in (self.heading, *self.cells))

    @property
    def wrapped_width(self) -> int:
        """Characters that the column takes if each word of its heading is on a line of its own."""
        return max(len(text) for text in (*self.heading.split(), *self.cells))


def terminal_tables(table: Table, width: int, lines_per_row: int | None) -> Iterator[Grid]:
    """Lays a table out for a terminal.

    The headings of a table of numbers wrap where it is too wide. If it is still too wide, it becomes several tables,
    each of which repeats the first column, since that names the rows. Tables of text are never split: Rich wraps
    their cells.

    Args:
        table: The table. Its first column names the rows; the others are numbers, or text if ``table.words``.
        width: Width of the terminal, in characters.
        lines_per_row: Approximate number of lines to which texts in the last column are shortened; None for whole
            texts.

    Yields:
        Tables that Rich can print, without borders.
    """
    columns = _columns(table)
    if lines_per_row is not None:
        columns[-1] = _shortened_last_column(columns, width, lines_per_row)
    width_of_gaps = COLUMN_GAP * (len(columns) - 1)
    total_width = sum(column.full_width for column in columns) + width_of_gaps
    if table.words or total_width <= width:
        yield _table_without_borders(columns, is_text=table.words)
        return
    row_names = columns[0]
    remaining_columns = columns[1:]
    while remaining_columns:
        count = _fitting_columns(row_names, remaining_columns, width)
        fitting_columns = remaining_columns[:count]
        remaining_columns = remaining_columns[count:]
        widths = [row_names.full_width]
        for column in fitting_columns:
            widths.append(column.wrapped_width)
        yield _table_without_borders([row_names, *fitting_columns], is_text=False, widths=widths)


def _columns(table: Table) -> list[Column]:
    """Returns the columns of a table, with control characters made visible."""
    columns = []
    for heading, *cells in zip(table.header, *table.rows, strict=True):
        texts = [escape_unprintable(cell) for cell in cells]
        columns.append(Column(escape_unprintable(heading), texts))
    return columns


def _shortened_last_column(columns: list[Column], width: int, lines_per_row: int) -> Column:
    """Returns the last column with texts short enough to fit next to the other columns.

    Args:
        columns: All columns of the table.
        width: Width of the terminal, in characters.
        lines_per_row: Number of lines that a text may take in the last column, each as wide as the room beside the
            other columns. Since lines break between words, a text that is shortened to their characters may still take
            one line more.
    """
    width_of_others = sum(column.full_width + COLUMN_GAP for column in columns[:-1])
    available_width = width - width_of_others
    max_characters = lines_per_row * available_width
    last_column = columns[-1]
    return Column(
        shortened(last_column.heading, available_width),
        [shortened(cell, max_characters) for cell in last_column.cells],
    )


def _fitting_columns(row_names: Column, columns: list[Column], width: int) -> int:
    """Returns how many columns fit next to the row names if their headings wrap.

    It is at least 1: a column that is too wide has to be shown somewhere.

    Args:
        row_names: The first column, which names the rows.
        columns: The columns that follow it.
        width: Width of the terminal, in characters.
    """
    count = 0
    used_width = row_names.full_width
    for column in columns:
        used_width += COLUMN_GAP + column.wrapped_width
        if used_width > width:
            break
        count += 1
    return max(count, 1)


def _table_without_borders(
    columns: list[Column], *, is_text: bool, widths: list[int] | None = None
) -> Grid:
    """Builds a table without borders for Rich, the library that prints to the terminal.

    Args:
        columns: Columns of the table. The first has the names of the rows, and never wraps.
        is_text: Whether the columns hold text, which is aligned to the left. Numbers are aligned to the right.
        widths: Width of each column, characters; None to let Rich choose them.

    Returns:
        The table.
    """
    grid = Grid(box=None, pad_edge=False)
    for index, column in enumerate(columns):
        has_row_names = index == 0
        is_left_aligned = has_row_names or is_text
        grid.add_column(
            column.heading,
            justify="left" if is_left_aligned else "right",
            no_wrap=has_row_names,
            width=None if widths is None else widths[index],
        )
    cells_by_column = [column.cells for column in columns]
    for row_cells in zip(*cells_by_column, strict=True):
        grid.add_row(*row_cells)
    return grid
