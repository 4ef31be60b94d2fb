"""Standard error as a terminal of Rich, which a command imports only where it shows something that moves there."""

from rich.console import Console

STDERR = Console(stderr=True, highlight=False, markup=False, emoji=False)
"""Standard error: its width, whether it is a terminal, and progress bars on it."""
