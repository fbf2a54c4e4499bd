"""The loop: collect, store, update, evaluate, log, checkpoint."""
