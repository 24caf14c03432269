"""The logs that autopilots write on board, read over MAVLink into files of the daemon."""
