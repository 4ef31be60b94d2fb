"""Links between pages, without what pages are made of, so that a fleet's judgement is quick to import."""

from typing import NamedTuple


class PageLink(NamedTuple):
    """A link to another page."""

    name: str
    """Text of the link."""

    address: str
    """Address of the page, relative to the one with the link."""

    needs_wide_screen: bool = False
    """Whether the other page is of no use on a telephone, which then has no link to it."""
