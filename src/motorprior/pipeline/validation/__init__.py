"""How far a prior is from motors that it was not fitted to, where the truth is known and where it is not."""
