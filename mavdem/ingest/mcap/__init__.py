"""MCAP recordings of MAVLink: records, and logs."""
