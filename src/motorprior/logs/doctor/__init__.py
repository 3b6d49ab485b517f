"""The log doctor: checks of a log, and what stands in the way of identifying motors from it."""
