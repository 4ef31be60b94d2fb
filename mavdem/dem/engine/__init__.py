"""The paper: generalized coordinates, the generative model, the free energy and the D, E and M steps."""
