"""Formats of logs: a reader each, their registry, and column maps for any other table."""
