"""Quick report of real logs, with which `motorprior demo --logs` begins."""
