"""Reports on what changed between two states of a vehicle, A and B: its figures and its status lights."""
