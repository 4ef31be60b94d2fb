"""Page: a result as one HTML file that can be mailed, printed and read without a network."""

from mavdem.page.document import Chapter, Drawing, render_page

__all__ = ["Chapter", "Drawing", "render_page"]
