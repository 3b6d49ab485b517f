"""Commands of real logs on a simulated robot: how far its motors are from the real ones, and the fleet that fits."""
