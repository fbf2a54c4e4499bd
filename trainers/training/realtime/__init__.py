"""Collection in wall-clock time, by a process that outlives the learner."""
