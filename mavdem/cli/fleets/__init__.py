"""Commands about many flights."""
