"""The DEM engine of the paper: generalized coordinates, the generative model, F̄, and the D, E and M steps."""
