"""Page: the index of a fleet."""
