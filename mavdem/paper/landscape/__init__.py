"""Section IV of the paper: the free energy manifold of a scalar system, drawn as it is maximised."""
