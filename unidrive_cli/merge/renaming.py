"""What becomes of the tokens and file names of one dataset that is merged."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any, get_type_hints

from unidrive_cli.tables.extra import IMAGE_ANNOTATIONS
from unidrive_cli.tables.schema import TABLES
from unidrive_cli.tables.tokens import moved_token

_TOKEN_FIELD = re.compile(r"(?:first_|last_)?(?P<table>.+)_tokens?")
FILE_FIELDS = ("filename", "info_filename")
"""Fields that name a file; the second one is T4's."""
_ALIASES = {"annotation": "sample_annotation"}


@dataclass
class Renaming:
    """New tokens and names, decided table by table.

    Attributes:
        plan_digest: of the dataset; new tokens derive from it.
        moved: tables of which every token is replaced.
        tokens: new tokens of rows that are united with rows of other datasets, by table; only those that change.
        scenes: new scene names, by old name.
        suffix: put into the names of all files that sample_data names; empty where they stay.
        files: new names of other files, by old name.
    """

    plan_digest: str
    moved: set[str] = field(default_factory=set)
    tokens: dict[str, dict[str, str]] = field(default_factory=dict)
    scenes: dict[str, str] = field(default_factory=dict)
    suffix: str = ""
    files: dict[str, str] = field(default_factory=dict)
    data_files: frozenset[str] = frozenset()
    """Names of an extra table's files that sample_data names too."""

    def token(self, table: str, token: Any) -> Any:
        """The new token of a row, or of none."""
        if not token or not isinstance(token, str):
            return token
        if table in self.moved:
            return moved_token(table, token, self.plan_digest)
        return self.tokens.get(table, {}).get(token, token)

    def data_file(self, name: str) -> str:
        """The new name of a file that sample_data names."""
        return suffixed(name, self.suffix) if self.suffix else name

    def file(self, table: str, name: str) -> str:
        """The new name of a file that a row of a table names."""
        if table in ("sample_data", IMAGE_ANNOTATIONS) or name in self.data_files:
            return self.data_file(name)
        return self.files.get(name, name)

    def record(self, table: str, row: Mapping[str, Any], known: Collection[str]) -> dict[str, Any]:
        """A row with its tokens, and the name of its file, replaced.

        Args:
            known: names of all tables that tokens may point to.
        """
        return {name: self._value(table, name, value, known) for name, value in row.items()}

    def touches(self, table: str, fields: Iterable[str], known: Collection[str]) -> bool:
        """Whether rows of a table, with these fields beside those of the schema, change."""
        changing = self.moved | {name for name, tokens in self.tokens.items() if tokens}
        for name in {*fields, *(get_type_hints(TABLES[table]) if table in TABLES else ())}:
            if target_of(table, name, known) in changing:
                return True
            if name in FILE_FIELDS and (self.suffix or self.files):
                return True
        return table == "scene" and bool(self.scenes)

    def _value(self, table: str, name: str, value: Any, known: Collection[str]) -> Any:
        if name in FILE_FIELDS and value and isinstance(value, str):
            return self.file(table, value)
        if name == "name" and table == "scene":
            return self.scenes.get(value, value)
        target = target_of(table, name, known)
        if target is None:
            return value
        if isinstance(value, list):
            return [self.token(target, item) for item in value]
        return self.token(target, value)


def target_of(table: str, name: str, known: Collection[str]) -> str | None:
    """The table to which a field points by token; None where it is another field."""
    if name in ("token", "prev", "next"):
        return "sample_annotation" if table == IMAGE_ANNOTATIONS else table
    match = _TOKEN_FIELD.fullmatch(name)
    if match is None:
        return None
    target = _ALIASES.get(match["table"], match["table"])
    return target if target in known else None


def suffixed(name: str, suffix: str) -> str:
    """A file name with a suffix in its last part: after the log in nuScenes' pattern, else before the first dot."""
    path = PurePosixPath(name)
    log, separator, rest = path.name.partition("__")
    if not separator:
        log, separator, rest = path.name.partition(".")
    return (path.parent / f"{log}{suffix}{separator}{rest}").as_posix()
