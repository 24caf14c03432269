"""Recorded flights, read from end to end in bounded memory: records, their times, the selection of some."""
