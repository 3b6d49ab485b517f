"""Stages: settings and input files become result files; finished stages are not run again.

In the order of the data flow: log_import; bench, identify, adapt, simulate; validation, replay and first_look; walking,
transfer_study, watching; virtual robots; demo and report, which use all of them.
"""
