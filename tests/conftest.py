"""Tests run in two processes: a file stays together, and whatever runs a whole rig of fakes shares one process. So do the
tests of the model, each kind of rod of which is compiled once, in the process that first needs it."""

from __future__ import annotations

from pathlib import Path

import pytest

GROUPS = {"lab": "rig", "safety": "rig", "model": "rods"}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        room = item.path.relative_to(here).parts[0]
        item.add_marker(pytest.mark.xdist_group(GROUPS.get(room, item.path.name)))
