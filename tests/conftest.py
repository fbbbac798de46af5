"""Tests run in two processes: a file stays together, and whatever runs a whole rig of fakes shares one process."""

from __future__ import annotations

from pathlib import Path

import pytest

WHOLE_RIG = ("lab", "safety")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        room = item.path.relative_to(here).parts[0]
        item.add_marker(pytest.mark.xdist_group("rig" if room in WHOLE_RIG else item.path.name))
