"""The one bound against hanging of tests in real time: what waits longer has hung. It is no measure of speed."""

HANG_S = 600.0
"""A test that takes 15 s alone took 230 s beside four lanes of CI on a processor of a third of the usual speed."""
