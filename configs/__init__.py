"""YAML configuration of every trainer, task, controller and experiment."""
