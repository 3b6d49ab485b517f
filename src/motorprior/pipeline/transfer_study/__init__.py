"""What policies are worth on motors that they were not trained on."""
