"""From a configuration to a trainer, checked before anything is built."""
