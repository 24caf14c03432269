"""Recorded flights, read from end to end in bounded memory: selection, tables, curves."""
