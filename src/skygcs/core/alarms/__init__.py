"""Alarms of the daemon: which events and states need a person, what belongs to one cause, and what was acknowledged."""
