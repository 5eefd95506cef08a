"""What a rule finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning"]
Broken = tuple[str, str]
"""Where a rule is broken (file, token and field), and the sentence that says how."""


@dataclass(frozen=True)
class Finding:
    """One broken rule.

    Attributes:
        rule: its ID.
        where: file, token and field.
        what: the sentence.
        severity: a dataset with an error cannot be used; a warning is mended and said, or some readers stumble.
    """

    rule: str
    where: str
    what: str
    severity: Severity = "error"

    @property
    def error(self) -> bool:
        """Whether the dataset cannot be used so; otherwise it is mended and said."""
        return self.severity == "error"
