"""Standard output and standard error as terminals of Rich, which a command imports only where it needs their style."""

from rich.console import Console

STDERR = Console(stderr=True, highlight=False, markup=False, emoji=False)
"""Standard error: its width, whether it is a terminal, and progress bars on it."""

STDOUT = Console(highlight=False, markup=False, emoji=False)
"""Standard output: lines in the colour of their level, if it is a terminal."""
