"""Beyond the paper: the simulation-error fit, mixer geometry as a prior, the noise model and shrinkage."""
