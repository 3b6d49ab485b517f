"""Quick report of real logs, the first part of `motorprior demo --logs`."""
