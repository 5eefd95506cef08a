"""REF: every token that the conversion or nuscenes-devkit follows must be there."""

from __future__ import annotations

from collections.abc import Iterator

from unidrive_cli.check.finding import Broken, Finding
from unidrive_cli.check.subject import Subject
from unidrive_cli.tables.dataset import Dataset

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
    """REF-1 and REF-2 of the list of rules (`rules.py`)."""
    for where, what in _dangling_tokens(dataset):
        yield Finding("REF-1", where, what)
    for where, what in _open_links(dataset):
        yield Finding("REF-2", where, what, "warning")


def dangling_tokens(subject: Subject) -> Iterator[Broken]:
    """Every token leads to a row.

    Readers stop with a KeyError.
    """
    yield from _dangling_tokens(subject.dataset)


def open_links(subject: Subject) -> Iterator[Broken]:
    """prev, next, first and last lead to rows of the dataset.

    Readers of tracks and sweeps stop with a KeyError; a conversion closes the lists.
    """
    yield from _open_links(subject.dataset)


def _dangling_tokens(dataset: Dataset) -> Iterator[Broken]:
    for table_name, field, target_name in REFERENCES:
        table = getattr(dataset, table_name)
        for row in table.rows_at(table.unlinked(field, getattr(dataset, target_name), empty=True)):
            token = getattr(row, field)
            if not _may_be_empty(table_name, field, row, token):
                yield table.place(row, field), f"points to {token!r}, which is not in {target_name}.json."

    annotations, attributes = dataset.sample_annotation, dataset.attribute.by_token
    for annotation in annotations.rows_at(annotations.rows_with_dangling("attribute_tokens", dataset.attribute)):
        for token in annotation.attribute_tokens:
            if token not in attributes:
                place = annotations.place(annotation, "attribute_tokens")
                yield place, f"points to {token!r}, which is not in attribute.json."


def _open_links(dataset: Dataset) -> Iterator[Broken]:
    for table_name, field, target_name in MENDABLE:
        table = getattr(dataset, table_name)
        for row in table.rows_at(table.unlinked(field, getattr(dataset, target_name), empty=False)):
            yield table.place(row, field), f"points to {getattr(row, field)!r}, which is not in {target_name}.json."


def _may_be_empty(table: str, field: str, row: object, token: str | None) -> bool:
    if token:
        return False
    if (table, field) == ("sample_data", "sample_token"):
        return not getattr(row, "is_key_frame", True)
    return (table, field) in (("sample_annotation", "visibility_token"), ("scene", "log_token"))
