"""Policies learn to walk on motors drawn for every episode."""
