"""Wind velocity in m/s, from attitude and velocity, with the drag of the vehicle."""
