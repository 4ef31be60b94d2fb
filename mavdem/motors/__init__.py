"""Motors and propellers: hover figures, trims, the detection of a lost thrust, and health between flights."""
