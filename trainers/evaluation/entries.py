"""Whose an entry of an evaluation is; without a prefix it is the latest policy's."""

from __future__ import annotations

CONTROLLER = "controller_"
"""Prefix of the entries of the controller alone."""
ACCEPTED = "accepted_"
"""Prefix of the entries of what the run hands over, where policies are tested for it."""
