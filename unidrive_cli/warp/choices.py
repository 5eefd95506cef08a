"""Choices of the warp that commands offer; nothing heavy is imported here."""

from __future__ import annotations

from typing import Literal

Blend = Literal["angular", "nearest"]
"""How overlapping sources are joined: mixed by weight, or the one with the largest weight."""
