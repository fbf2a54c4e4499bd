"""The paper's claims, each tested by the numbers of its experiment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from . import criteria
from .outcomes import Finding, Findings


@dataclass(frozen=True)
class Claim:
    """One claim of the paper.

    Attributes:
        number: As the checks are numbered.
        words: What is claimed; "it" is residual RL.
        paper: The paper's own numbers or words, and where they stand.
        experiment: Name of the experiment that decides it.
        test: From what was found to whether it holds, and the numbers that decide.
    """

    number: str
    words: str
    paper: str
    experiment: str
    test: Callable[[Finding], tuple[bool, str]]

    def __str__(self) -> str:
        return f"{self.number}. {self.words}"

    @property
    def criterion(self) -> str:
        """How it is tested, in one sentence."""
        return " ".join((self.test.__doc__ or "").split())


@dataclass(frozen=True)
class Verdict:
    """What became of a claim.

    Attributes:
        claim: The claim.
        holds: None if runs of its experiment are missing, or what it needs of them.
        numbers: The numbers that decide.
    """

    claim: Claim
    holds: bool | None
    numbers: str

    @property
    def word(self) -> str:
        """The verdict."""
        return {True: "holds", False: "does not hold", None: "not tested"}[self.holds]


def judge(findings: Findings) -> list[Verdict]:
    """Return a verdict on every claim whose experiment is there; none on a part of its runs."""
    return [_verdict(c, findings[c.experiment]) for c in CLAIMS if c.experiment in findings]


def _verdict(claim: Claim, finding: Finding) -> Verdict:
    if finding.missing:
        return Verdict(claim, None, f"finished so far: {finding.missing}")
    try:
        return Verdict(claim, *claim.test(finding))
    except (IndexError, KeyError) as missing:
        return Verdict(claim, None, f"it needs {missing}")


CLAIMS: Sequence[Claim] = (
    Claim(
        "1a",
        "In simulation residual RL learns faster than RL alone",
        "fewer samples (figure 2)",
        "curves-sim",
        criteria.learns_faster,
    ),
    Claim(
        "1b",
        "In simulation residual RL ends above the controller",
        "above it (figure 2)",
        "curves-sim",
        criteria.ends_above,
    ),
    Claim(
        "2a",
        "On the real-like task it learns faster than RL alone",
        "fewer samples (figure 2)",
        "curves-real",
        criteria.learns_faster,
    ),
    Claim(
        "2b",
        "On the real-like task it ends above the controller",
        "above it (figure 2)",
        "curves-real",
        criteria.ends_above,
    ),
    Claim(
        "3",
        "It stays level as the blocks turn, the controller falls",
        "a constant average against a decrease (figure 3 a)",
        "rotation",
        criteria.stays_level,
    ),
    Claim(
        "4",
        "It stays level as control noise grows",
        "a constant return (figure 3 b)",
        "noise",
        criteria.withstands_noise,
    ),
    Claim(
        "5",
        "It stays level as control bias grows, the controller falls",
        "a constant return against a decrease (figure 3 c)",
        "bias",
        criteria.stays_level,
    ),
    Claim(
        "6a",
        "Misaligned: about 15 of 20, by the controller about 2",
        "15 of 20, controller 2 of 20 (figure 4 a)",
        "table",
        criteria.solves_misaligned,
    ),
    Claim(
        "6b",
        "Aligned: 20 of 20, and so by the controller",
        "20 of 20, controller 20 of 20 (figure 4 a)",
        "table",
        criteria.solves_aligned,
    ),
    Claim(
        "7",
        "Misaligned success grows within 8000 samples",
        "gradually, over 8000 samples (figure 4 b)",
        "success-real",
        criteria.success_grows,
    ),
    Claim(
        "8",
        "Bias does not stop learning, real-like task",
        "no significant issues (figure 4 c)",
        "bias-real",
        criteria.learns_under_bias,
    ),
    Claim(
        "9",
        "On a policy from simulation: under 1000 steps",
        "under 1000 steps (figure 5)",
        "sim-to-real",
        criteria.transfers_quickly,
    ),
    Claim(
        "10",
        "RL alone visits a wider spread of states",
        "a broader spatial variance (section VI)",
        "exploration",
        criteria.explores_wider,
    ),
)
