"""Facts: what is found of a flight, a vehicle or a file, as typed records; words about them are made in `report`."""

from mavdem.facts.fact import Code, Fact, Facts, Figure, Level, NamedFacts

__all__ = ["Code", "Fact", "Facts", "Figure", "Level", "NamedFacts"]
