"""The command line: it composes what the other packages make, and computes nothing."""
