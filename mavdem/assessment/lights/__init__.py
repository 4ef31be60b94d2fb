"""Lights: eight facts, one for each subject of a log, each measured and judged in the file of its name."""
