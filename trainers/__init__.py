"""Training, evaluation, command line."""
