"""Health: what a flight's figures say of motors and propellers, against the vehicle's own healthy flights."""
