"""Inspection of trained policies: films, MuJoCo's viewer, a report page."""
