"""Reports about many flights."""
