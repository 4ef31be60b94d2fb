"""DEM on a stream: the online learner."""
