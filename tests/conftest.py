"""Fixtures that several tests share."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of real data, or a skip that says why."""
    folder = Path(os.environ.get("SHADOWGRAM_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("real data not found; set SHADOWGRAM_DATA to the folder that holds it")
    return folder
