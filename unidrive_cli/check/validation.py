"""All rules on one dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from unidrive_cli.check.finding import Finding
from unidrive_cli.check.rules import RULES, Rule, Stage, refused_by_devkit
from unidrive_cli.check.subject import PictureSize, Subject
from unidrive_cli.errors import DatasetError
from unidrive_cli.tables.dataset import version_folder
from unidrive_cli.tables.layouts.known import layout_named, layout_of

UNREADABLE_RULE, UNFINISHED_RULE, REFERENCES_RULE, DEVKIT_RULE = "STR-2", "STR-4", "REF-1", "DEV-1"
KEPT_FINDINGS = 1000
"""So many findings of a rule are kept; all are counted."""


@dataclass
class Validation:
    """What the rules have found.

    Attributes:
        root, version: the dataset.
        findings: by rule, at most KEPT_FINDINGS of each.
        counts: of all findings, by rule; of the rules that were looked at.
        not_checked: rules that could not be looked at, because of what others have found.
        opened_with_devkit: whether nuscenes-devkit has opened it.
        fixed: rows that were changed, by table.
    """

    root: Path
    version: str
    findings: list[Finding] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    not_checked: list[str] = field(default_factory=list)
    opened_with_devkit: bool = False
    fixed: dict[str, int] = field(default_factory=dict)

    @property
    def total(self) -> int:
        """How many findings there are, those that were not kept included."""
        return self.counts.total()

    @property
    def fixable(self) -> bool:
        """Whether a rule is broken that can be mended, and what that needs is in order."""
        needed = any(self.counts[rule] for rule in (UNFINISHED_RULE, UNREADABLE_RULE, REFERENCES_RULE))
        return not needed and any(rule.fixable and self.counts[rule.id] for rule in RULES)

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "schema_version": 1,
            "dataset": str(self.root),
            "version": self.version,
            "findings": [asdict(finding) for finding in self.findings],
            "counts": dict(self.counts),
            "left_off": self.total - len(self.findings),
            "not_checked": self.not_checked,
            "opened_with_devkit": self.opened_with_devkit,
            "fixed": self.fixed,
        }


def find_subject(
    root: Path, version: str | None, picture_size: PictureSize, jobs: int = 1, layout: str | None = None
) -> Subject:
    """The dataset in a folder, not opened yet.

    Args:
        layout: name of its layout; found out where None.

    Raises:
        DatasetError, UsageError: as `open_dataset`, of the version folder.
    """
    try:
        known = layout_named(layout) if layout else None
        folder = version_folder(root, version, known)
        return Subject(folder, known or layout_of(folder), picture_size, jobs)
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(error.filename or root)) from error


def validate(subject: Subject, progress: Callable[[int, int, str], None] | None = None) -> Validation:
    """Looks at a dataset with all rules.

    Args:
        progress: told how many rules are done, of how many, and which comes next.

    Raises:
        DatasetError: nothing of it can be read.
    """
    found = Validation(subject.folder.parent, subject.folder.name)
    reached = max(Stage)
    for done, rule in enumerate(RULES):
        if progress:
            progress(done, len(RULES), rule.id)
        if rule.needs > reached or (rule.check is refused_by_devkit and _devkit_need_not_be_asked(found)):
            found.not_checked.append(rule.id)
            continue
        _look(subject, rule, found)
        if rule.first and found.counts[rule.id]:
            reached = min(reached, rule.needs)
    found.opened_with_devkit = found.counts.get(DEVKIT_RULE) == 0
    return found


def _look(subject: Subject, rule: Rule, found: Validation) -> None:
    found.counts[rule.id] = 0
    try:
        for where, what in rule.check(subject):
            if found.counts[rule.id] < KEPT_FINDINGS:
                found.findings.append(Finding(rule.id, where, what, rule.severity))
            found.counts[rule.id] += 1
    except DatasetError as error:
        if rule.needs is Stage.FOLDER:
            raise
        found.not_checked.append(rule.id)
        finding = Finding(UNREADABLE_RULE, error.where, error.what)  # large tables are decoded as they are used
        if finding not in found.findings:
            found.findings.append(finding)
            found.counts[UNREADABLE_RULE] += 1


def _devkit_need_not_be_asked(found: Validation) -> bool:
    return any(found.counts[rule.id] for rule in RULES if rule.devkit) or found.counts[UNREADABLE_RULE] > 0
