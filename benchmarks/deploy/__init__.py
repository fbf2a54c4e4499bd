"""An exported policy beside the trainer's own chain: latency, missed deadlines, memory, start, frozen episodes."""
