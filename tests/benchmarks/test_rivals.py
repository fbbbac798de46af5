"""Textbook methods name a clear cause of a clean toy problem, and nothing where nothing is."""

import pytest

from benchmarks.rivals import METHODS
from tests.diagnosis.toy import toy_problem


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("truth", [{"turned": 1.5}, {"stiffer": 1.5}, {}])
def test_a_clear_cause_is_named_and_none_where_there_is_none(method: str, truth: dict[str, float]) -> None:
    found = METHODS[method](toy_problem(3, truth))["attribute"]
    assert found["effects"] == list(truth) and found["verdict"] == ("effect" if truth else "none")
    assert sum(r["probability"] for r in found["ranking"]) == pytest.approx(1.0, abs=1e-6)
    assert 0.5 < found["probability"] <= 1
