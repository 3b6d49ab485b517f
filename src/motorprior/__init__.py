"""motorprior: learn the distribution of a robot's motors from logs, train policies on samples of it."""

__version__ = "0.1.0"
