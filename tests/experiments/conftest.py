"""Studies for tests, in a module that worker processes can import as well."""

from pathlib import Path

import pytest


@pytest.fixture
def little(monkeypatch):
    """The module `little`."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import little

    return little
