"""motorprior: learn the distribution of a robot's motors from logs, train policies on samples of it."""

from motorprior import kernel_cache

__version__ = "0.1.0"

kernel_cache.choose_folder()  # the one thing that happens at import: numba reads the variable when it is imported
