"""The fence that an autopilot keeps in parameters: set, read, and tested on foot."""
