"""Evaluation of policies on motors that they were not trained on."""
