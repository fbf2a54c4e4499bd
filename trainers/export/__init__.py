"""From a trained policy to a folder that a robot can run."""
