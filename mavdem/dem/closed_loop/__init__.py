"""The closed loop: outputs and inputs as one process, since the motors answer what the outputs do."""
