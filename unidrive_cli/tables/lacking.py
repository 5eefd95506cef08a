"""Fields that readers ask for and a source's rows may lack."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from typing import Any

import msgspec

from unidrive_cli.tables.schema import Row
from unidrive_cli.tables.table import ListedTable, Table

NOT_COUNTED = -1
"""Points in a box, as Lyft writes them: nuscenes-devkit's evaluation keeps such boxes, and drops those with 0."""
ASKED_FOR: dict[str, dict[str, Any]] = {
    "log": {"logfile": "", "location": ""},
    "map": {"filename": "", "log_tokens": []},
    "scene": {"description": ""},
    "instance": {"nbr_annotations": 0, "first_annotation_token": "", "last_annotation_token": ""},
    "sample_annotation": {
        "prev": "",
        "next": "",
        "visibility_token": "",
        "attribute_tokens": [],
        "num_lidar_pts": NOT_COUNTED,
        "num_radar_pts": 0,
    },
}
"""By table: fields without which nuscenes-devkit or what is built on it stops, and which the schema does not need
to read a row; and what a row without one gets."""


class _Log(Row, frozen=True, gc=False):
    """What the logs of nuScenes' teaser sets have beyond nuScenes'."""

    map_token: Any = None


def lacking(table: Table[Any]) -> dict[int, list[str]]:
    """The fields of ASKED_FOR that rows lack, by the row's index. Those of a scanned table lack none."""
    if not isinstance(table, ListedTable):
        return {}
    fields = list(ASKED_FOR[table.name])
    kind = msgspec.defstruct("Asked", [(field, Any, msgspec.UNSET) for field in fields], gc=False)
    decode, values_of = msgspec.json.Decoder(kind).decode, msgspec.structs.astuple
    found = {}
    for index, raw in enumerate(table.raw):
        values = values_of(decode(raw))
        if msgspec.UNSET in values:
            found[index] = [field for field, value in zip(fields, values, strict=True) if value is msgspec.UNSET]
    return found


def completed(tables: dict[str, Any]) -> Iterator[str]:
    """Puts the fields of ASKED_FOR in, in place, and says so in a sentence per field.

    Args:
        tables: by name; some may be missing.
    """
    for name, values in ASKED_FOR.items():
        if name not in tables or not (found := lacking(tables[name])):
            continue
        changes = {index: {field: values[field] for field in fields} for index, fields in found.items()}
        said = {field: f"{msgspec.json.encode(value).decode()} is put in" for field, value in values.items()}
        if name == "map" and "log" in tables and (named := _logs_by_map(tables["log"])):
            said["log_tokens"] = "the logs with their map_token are put in"
            for index, fields in changes.items():
                if "log_tokens" in fields:
                    fields["log_tokens"] = named[tables["map"].rows[index].token]
        tables[name] = tables[name].mended(changes)
        for field, count in Counter(field for fields in found.values() for field in fields).items():
            yield f"{name}.json: {field} is missing in {count} rows; {said[field]}."


def _logs_by_map(logs: ListedTable[Any]) -> defaultdict[str, list[str]]:
    """Tokens of the logs that name their map, by the map's token."""
    found: defaultdict[str, list[str]] = defaultdict(list)
    for raw in logs.raw:
        log = msgspec.json.decode(raw, type=_Log)
        if isinstance(log.map_token, str):
            found[log.map_token].append(log.token)
    return found
