"""Tokens of new rows: derived, so that a rerun gives the same bytes."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

Hashes = npt.NDArray[np.uint64]


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


def moved_token(table: str, token: str, plan_digest: str) -> str:
    """A 32-digit hexadecimal token for a row that is merged with a dataset which has its token already.

    Args:
        table: name of the row's table.
        token: the row's token in the dataset that it comes from.
        plan_digest: of the conversion that wrote that dataset.
    """
    text = "\n".join(("unidrive merge", table, token, plan_digest))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def short_hashes(texts: Iterable[str]) -> Hashes:
    """(n,) 64-bit hashes of tokens or names: alike on every machine, and small enough to be kept for millions."""
    joined = bytearray()
    for text in texts:
        joined += hashlib.blake2b(text.encode(errors="surrogatepass"), digest_size=8).digest()
    return np.frombuffer(joined, dtype="<u8")
