"""Frames of a learned excitation.

A frame is a position target and TORQUES_PER_FRAME external torques of one control period.
"""

TORQUES_PER_FRAME = 5
CHANNELS = 1 + TORQUES_PER_FRAME
