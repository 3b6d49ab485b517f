"""Training of walking policies on motors drawn for every episode."""
