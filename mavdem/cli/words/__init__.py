"""Words of commands: what takes a file of its own to be put into words."""
