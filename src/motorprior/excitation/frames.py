"""Frames of a learned excitation: a position target and SUB external torques per control period."""

SUB = 5  # external torques per frame
CHANNELS = 1 + SUB
