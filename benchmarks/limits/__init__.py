"""Whether the safety limits hold, under the worst commands that can be thought of."""
