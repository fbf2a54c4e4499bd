"""Runs as processes: a local pool or a Ray cluster, resumable, with one display."""
