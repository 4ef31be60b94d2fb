"""Sections of a scenario file: what all tables share, and the tables of what breaks."""
