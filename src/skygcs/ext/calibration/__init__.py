"""Calibration of the sensors of disarmed vehicles."""
