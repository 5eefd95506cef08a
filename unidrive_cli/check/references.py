"""REF: every token that the conversion or nuscenes-devkit follows must be there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from unidrive_cli.tables.dataset import Dataset


@dataclass(frozen=True)
class Finding:
    """One broken rule.

    Attributes:
        rule: its ID.
        where: file, token and field.
        what: the sentence.
        error: whether the dataset cannot be used so; otherwise it is mended and said.
    """

    rule: str
    where: str
    what: str
    error: bool = True


REFERENCES = (
    ("calibrated_sensor", "sensor_token", "sensor"),
    ("scene", "log_token", "log"),
    ("sample", "scene_token", "scene"),
    ("sample_data", "sample_token", "sample"),
    ("sample_data", "ego_pose_token", "ego_pose"),
    ("sample_data", "calibrated_sensor_token", "calibrated_sensor"),
    ("sample_annotation", "sample_token", "sample"),
    ("sample_annotation", "instance_token", "instance"),
    ("sample_annotation", "visibility_token", "visibility"),
    ("instance", "category_token", "category"),
)
"""(table, field, table it points to) of the links that must hold."""

MENDABLE = (
    ("scene", "first_sample_token", "sample"),
    ("scene", "last_sample_token", "sample"),
    ("sample", "prev", "sample"),
    ("sample", "next", "sample"),
    ("sample_data", "prev", "sample_data"),
    ("sample_data", "next", "sample_data"),
    ("sample_annotation", "prev", "sample_annotation"),
    ("sample_annotation", "next", "sample_annotation"),
    ("instance", "first_annotation_token", "sample_annotation"),
    ("instance", "last_annotation_token", "sample_annotation"),
)
"""Links that extracts of a dataset leave open: nothing is lost when they are closed again."""


def check_references(dataset: Dataset) -> Iterator[Finding]:
    """REF-1: a token points to no row. REF-2: a list link points outside of the dataset."""
    for table_name, field, target_name in REFERENCES + MENDABLE:
        mendable = (table_name, field, target_name) in MENDABLE
        table = getattr(dataset, table_name)
        unlinked = table.unlinked(field, getattr(dataset, target_name), empty=not mendable)
        for row in table.rows_at(unlinked):
            token = getattr(row, field)
            if _may_be_empty(table_name, field, row, token):
                continue
            yield Finding(
                "REF-2" if mendable else "REF-1",
                table.place(row, field),
                f"points to {token!r}, which is not in {target_name}.json.",
                error=not mendable,
            )

    annotations, attributes = dataset.sample_annotation, dataset.attribute.by_token
    for annotation in annotations.rows_at(annotations.rows_with_dangling("attribute_tokens", dataset.attribute)):
        for token in annotation.attribute_tokens:
            if token not in attributes:
                place = annotations.place(annotation, "attribute_tokens")
                yield Finding("REF-1", place, f"points to {token!r}, which is not in attribute.json.")


def _may_be_empty(table: str, field: str, row: object, token: str | None) -> bool:
    if token:
        return False
    if (table, field) == ("sample_data", "sample_token"):
        return not getattr(row, "is_key_frame", True)
    return (table, field) in (("sample_annotation", "visibility_token"), ("scene", "log_token"))
