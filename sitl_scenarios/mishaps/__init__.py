"""Mishaps of a simulated flight: what breaks, which sensor errs, what the pilot does, and what the link repeats."""
