"""The fake Motive that a test asks for."""

import pytest
from natnet_rig import Motive

from tests.simulated.bench import Bench


@pytest.fixture
def motive(bench: Bench, request: pytest.FixtureRequest) -> Motive:
    return Motive(bench, **getattr(request, "param", {}))
