"""The wind in m/s as what a vehicle leans into: the drag, and the motion of the air."""
