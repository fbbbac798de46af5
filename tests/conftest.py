"""Tests run in two processes: a file stays together, and whatever runs a whole rig of fakes shares one process. So do the
tests of model and diagnosis, each kind of rod of which is compiled once, in the process that first needs it."""

from __future__ import annotations

from pathlib import Path

import pytest

GROUPS = {"safety": "rig", "model": "rods", "diagnosis": "rods", "test_blind_wire.py": "rig"}
"""By folder or file."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        room, file = item.path.relative_to(here).parts[0], item.path.name
        whole_rig = "virtual_lab" in getattr(item, "fixturenames", ())
        item.add_marker(pytest.mark.xdist_group("rig" if whole_rig else GROUPS.get(file, GROUPS.get(room, file))))
