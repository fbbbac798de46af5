"""Tests run in three processes. Whatever runs a whole rig of fakes shares one of them, and so does what would starve a rig (a
cluster of processes); so does whatever solves rods, each kind of which is compiled once, in the process that first needs it.
All others stay together file by file."""

from __future__ import annotations

from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling

RIG, RODS = "rig", "rods"
GROUPS = {
    "docs": RIG,
    "safety": RIG,
    "test_call_order.py": "call order",
    "test_call_order_network.py": "call order",
    "test_bad_input.py": RIG,
    "test_blind_wire.py": RIG,
    "test_check_moves.py": RIG,
    "test_cluster.py": RIG,
    "test_end_to_end.py": RIG,
    "test_plain_text_on_a_rig.py": RIG,
    "test_proposed_experiments.py": RIG,
    "test_resume.py": RIG,
    "test_who_may_speak.py": RIG,
    "diagnosis": RODS,
    "model": RODS,
    "test_blind_bench.py": RODS,
    "test_diagnose_verb.py": RODS,
    "test_diagnosis_page.py": RODS,
    "test_docstring_examples.py": RODS,
    "test_effects_verb.py": RODS,
    "test_paper.py": RODS,
    "test_paper_findings.py": RODS,
    "test_pushes_page.py": RODS,
    "test_sampled_evidence.py": RODS,
}
"""By folder or file. (The marks of pytest-xdist 3.8 for groups do nothing with pytest 9.2.)"""


class ByGroup(LoadScopeScheduling):  # type: ignore[misc]
    """Hands out groups, those of most tests first."""

    def _split_scope(self, nodeid: str) -> str:
        path = nodeid.partition("::")[0].removeprefix("tests/").split("/")
        return GROUPS.get(path[-1], GROUPS.get(path[0], "/".join(path)))


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByGroup:
    return ByGroup(config, log)
