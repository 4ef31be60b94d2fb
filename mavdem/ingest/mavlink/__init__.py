"""MAVLink: frames, message definitions, the boot clock, and the messages of each component."""
