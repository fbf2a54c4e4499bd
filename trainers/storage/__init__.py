"""What survives a crash: transitions, checkpoints, the files of a run."""
