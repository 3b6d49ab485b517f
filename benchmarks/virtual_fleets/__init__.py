"""Models of motors compared with the true motors of virtual fleets."""
