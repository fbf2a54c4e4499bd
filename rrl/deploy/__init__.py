"""Run an exported policy on a robot: NumPy and onnxruntime, no torch.

``rrl export run=RUN`` writes a folder; :class:`Policy` runs it::

    policy = Policy("export", rate=20.0)
    command = policy.act({"position": position, "goal": goal})
"""

from rrl.deploy.contract import Contract, Entry, read_contract
from rrl.deploy.policy import Policy

__all__ = ["Contract", "Entry", "Policy", "read_contract"]
