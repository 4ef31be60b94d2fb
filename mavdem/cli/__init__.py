"""The command line: it composes what the other rooms make, and computes nothing."""
