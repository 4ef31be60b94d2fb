"""Flights and results as tables, MCAP channels and other log formats."""
