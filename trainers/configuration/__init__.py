"""From a configuration to a trainer, checked before any environment is built."""
