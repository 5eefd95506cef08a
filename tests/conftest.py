"""Fixtures that several rooms' tests share."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("unidrive", deadline=None)  # a busy machine is no fault of the code
settings.load_profile("unidrive")
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as of what a shell starts in the background
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of small real datasets; skips where it is absent, fails where it must be there."""
    folder = Path(os.environ.get("UNIDRIVE_TEST_DATA") or Path(__file__).parents[1] / ".." / "shared" / "data")
    if not folder.is_dir():
        sentence = f"shared test data not found at {folder}; set UNIDRIVE_TEST_DATA"
        if os.environ.get("UNIDRIVE_REQUIRE_TEST_DATA") == "1":
            pytest.fail(sentence)
        pytest.skip(sentence)
    return folder.resolve()
