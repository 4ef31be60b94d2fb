"""Forecasts beyond the paper: the joint autoregression of outputs and motors, and the simulation-error fit of θ."""
