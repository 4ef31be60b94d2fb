"""HTML pages: of one flight, of a fleet, of two flights compared, and of the library of `mavdem serve`."""
