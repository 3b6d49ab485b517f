"""Explanations of a bad fit: what in the logs contradicts the model, and what cures it."""
