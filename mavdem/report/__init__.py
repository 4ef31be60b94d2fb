"""Reports: a result in sentences and tables."""
