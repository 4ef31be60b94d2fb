"""MCAP recordings of MAVLink: records, logs and writing."""
