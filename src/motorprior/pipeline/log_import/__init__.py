"""Recordings of any robot become motor logs."""
