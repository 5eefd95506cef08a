"""The rules: one list, one ID and one line each. `docs/rules.md` is made of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum

from unidrive_cli.check import cameras, files, lists, poses, records, references, structure
from unidrive_cli.check.finding import Broken, Severity
from unidrive_cli.check.subject import Subject
from unidrive_cli.errors import CheckError
from unidrive_cli.tables.thinned import open_with_devkit

PAGE = "docs/rules.md"
PAGE_COMMAND = f"unidrive validate --rules > {PAGE}"


class Stage(IntEnum):
    """How much of a dataset is in order: its folder is there, its tables can be read, their tokens are unique."""

    FOLDER = 0
    TABLES = 1
    TOKENS = 2


@dataclass(frozen=True)
class Rule:
    """One rule.

    Attributes:
        id: what findings are known by; never used again for another rule.
        severity: of its findings.
        check: yields where it is broken; its docstring says what must be so, then who stumbles where it is not.
        needs: what of the dataset must be in order before it can be looked at.
        first: whether rules that need more cannot be looked at where it is broken.
        devkit: whether nuscenes-devkit need not be asked where it is broken.
        fixable: whether `--fix` mends it.
    """

    id: str
    severity: Severity
    check: Callable[[Subject], Iterator[Broken]]
    needs: Stage = Stage.TOKENS
    first: bool = False
    devkit: bool = False
    fixable: bool = False

    @property
    def says(self) -> str:
        """What must be so."""
        return self._paragraphs[0]

    @property
    def why(self) -> str:
        """Who stumbles where it is not so."""
        return self._paragraphs[1]

    @property
    def _paragraphs(self) -> list[str]:
        return [" ".join(text.split()) for text in f"{self.check.__doc__}\n\n".split("\n\n")]


def refused_by_devkit(subject: Subject) -> Iterator[Broken]:
    """nuscenes-devkit opens the dataset and projects the boxes of a few samples.

    So do most trainers. It is asked where no rule is broken that it needs; of more than 20 scenes it gets 20.
    """
    try:
        open_with_devkit(subject.dataset)
    except CheckError as error:
        yield str(subject.folder), error.what


RULES = (
    Rule("STR-1", "error", structure.missing_needed_tables, needs=Stage.FOLDER, first=True),
    Rule("STR-2", "error", structure.unreadable_tables, needs=Stage.FOLDER, first=True),
    Rule("STR-3", "error", structure.missing_tables, needs=Stage.FOLDER, devkit=True),
    Rule("STR-4", "error", structure.unfinished_conversions, needs=Stage.FOLDER),
    Rule("STR-5", "error", structure.repeated_tokens, needs=Stage.TABLES, first=True),
    Rule("STR-6", "error", structure.maps_lacking_fields, devkit=True),
    Rule("STR-7", "warning", structure.rows_lacking_fields),
    Rule("REF-1", "error", references.dangling_tokens, devkit=True),
    Rule("REF-2", "warning", references.open_links, fixable=True),
    Rule("REF-3", "error", structure.logs_without_map, devkit=True),
    Rule("LINK-1", "error", lists.one_way_links, fixable=True),
    Rule("LINK-2", "error", lists.links_elsewhere, fixable=True),
    Rule("LINK-3", "error", lists.lists_in_pieces, fixable=True),
    Rule("TIME-1", "error", lists.times_not_rising),
    Rule("REC-1", "error", records.wrong_sample_counts, fixable=True),
    Rule("REC-2", "error", records.wrong_annotation_counts, fixable=True),
    Rule("REC-3", "error", records.wrong_scene_ends, fixable=True),
    Rule("REC-4", "error", records.wrong_instance_ends, fixable=True),
    Rule("REC-5", "error", records.repeated_scene_names),
    Rule("REC-6", "error", records.repeated_channels),
    Rule("REC-7", "error", records.unknown_modalities),
    Rule("REC-8", "warning", records.scenes_in_no_split),
    Rule("KEY-1", "error", records.repeated_key_frames),
    Rule("KEY-2", "warning", records.missing_key_frames),
    Rule("POSE-1", "error", poses.no_rotations, devkit=True),
    Rule("POSE-2", "error", poses.far_translations),
    Rule("POSE-3", "error", poses.rotations_not_unit),
    Rule("BOX-1", "error", poses.sizeless_boxes),
    Rule("CAM-1", "error", cameras.wrong_intrinsics, devkit=True),
    Rule("CAM-2", "error", cameras.intrinsics_of_others),
    Rule("CAM-3", "error", cameras.wrong_distortion),
    Rule("FILE-1", "error", files.files_outside, devkit=True),
    Rule("FILE-2", "error", files.missing_files, devkit=True),
    Rule("PIC-1", "error", files.pictures_of_other_size),
    Rule("PIC-2", "warning", files.pictures_without_size, devkit=True),
    Rule("DEV-1", "error", refused_by_devkit),
)
"""In the order in which they are looked at."""


def rules_page() -> str:
    """The list as a page of Markdown."""
    lines = [
        f"<!-- Made from the list in unidrive_cli/check/rules.py by: {PAGE_COMMAND} -->",
        "",
        "# The rules that `unidrive validate` looks at",
        "",
        "| ID | severity | what must be so | where it is not |",
        "| --- | --- | --- | --- |",
    ]
    for rule in RULES:
        mended = " `--fix` mends it." if rule.fixable else ""
        lines.append(f"| {rule.id} | {rule.severity} | {rule.says} | {rule.why}{mended} |")
    return "\n".join([*lines, ""])
