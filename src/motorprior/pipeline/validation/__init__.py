"""Errors of priors and baselines on held-out motors of a simulated fleet, and on held-out logs of real motors."""
