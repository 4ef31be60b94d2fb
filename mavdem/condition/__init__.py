"""Condition: what a log says of its vehicle at any rate: tier, identity, balance, limits, vibration, battery."""
