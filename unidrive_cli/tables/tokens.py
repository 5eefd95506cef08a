"""Tokens of new rows: derived, so that a rerun gives the same bytes."""

from __future__ import annotations

import hashlib


def derived_token(table: str, source_token: str, rig_digest: str, channel: str) -> str:
    """A 32-digit hexadecimal token for a row that unidrive adds.

    Args:
        table: name of the table the row goes to.
        source_token: the source row that it stands for (a sample's token), or empty.
        rig_digest: `Rig.digest` of the virtual rig.
        channel: the virtual camera.
    """
    text = "\n".join(("unidrive", table, source_token, rig_digest, channel))
    return hashlib.sha256(text.encode()).hexdigest()[:32]
