"""Replay of the commands of real logs on a simulated robot: errors of its motors, and calibration of a fleet."""
