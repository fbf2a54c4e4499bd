"""The insertion task and its environments."""
