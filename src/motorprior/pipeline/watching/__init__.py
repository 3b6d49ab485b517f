"""Trained policies to look at: films, a window, a page."""
