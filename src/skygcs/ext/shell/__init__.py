"""[shell] of the fleet file: the console of a PX4 over MAVLink, for one client at a time."""
