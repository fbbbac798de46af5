"""Clocks: the instrument's clock is found below the delays of the wire, and wall time may jump as it likes."""

import json
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_run import TARGETS, state

from recordings.campaign.info import info
from recordings.errors import MissingStream
from recordings.file.clocks import aligned, fit
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from recordings.states.concluding import conclude
from recordings.states.rules import Window


@settings(max_examples=25)
@given(st.floats(-1e4, 1e4), st.floats(-2e-4, 2e-4), st.integers(0, 2**31))
def test_offset_and_drift_are_found_below_delays_of_any_size(offset: float, drift: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    device = 5e3 + np.arange(0, 120, 0.008)
    delay = 0.4e-3 + random.exponential(3e-3, len(device))
    model = fit(device, device + offset + drift * (device - device[0]) + delay)
    assert model.drift == pytest.approx(drift, abs=2e-6)
    assert model.offset == pytest.approx(offset + 0.4e-3, abs=0.1e-3)
    assert model.residual == pytest.approx(3e-3 * np.log(2), rel=0.1)


def test_no_sample_arrives_before_the_model_says_it_was_taken() -> None:
    random = np.random.default_rng(3)
    device = np.cumsum(random.uniform(0.005, 0.02, 5000))
    host = device * (1 + 5e-5) + 7.0 + random.gamma(2, 1e-3, 5000)
    model = fit(device, host)
    assert model is not None and (host - model.host(device)).min() > -1e-9
    assert np.abs(model.host(device) - (device * (1 + 5e-5) + 7.0)).max() < 0.3e-3


def test_a_clock_that_restarts_is_modelled_since_then_and_too_few_samples_give_none() -> None:
    device = np.concatenate([np.arange(1000, 1010, 0.01), np.arange(0, 10, 0.01)])
    host = np.arange(2000) * 0.01
    model = fit(device, host)
    assert model is not None and model.restarts == 1 and model.samples == 1000
    assert model.offset == pytest.approx(10.0) and model.drift == pytest.approx(0.0, abs=1e-9)
    assert fit(device[:5], host[:5]) is None
    assert fit(np.full(100, 3.0), host[:100]) is None


def test_the_model_is_stored_in_the_file_and_aligns_its_stream(tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    taken = np.arange(1.0, 11.0, 0.01)
    with Recorder(tmp_path / "a.mcap", start_wall_ns=10**18) as recorder:
        for k, t in enumerate(taken.tolist()):
            arrived = round(t + random.exponential(2e-3) * (k % 5 > 0), 9)
            values = (t + 500.0, k, (0.0, 0.0, 0.4), (1.0, 0.0, 0.0, 0.0), 1e-4, True, ())
            recorder.push("/tip", max(arrived, recorder.buffers.newest("/tip")), values)
    recording = Recording.open(tmp_path / "a.mcap")
    model = info(tmp_path / "a.mcap").clocks["/tip"]
    assert json.loads(recording.metadata["clocks"]["/tip"]) == asdict(model)
    assert np.abs(recording.stream("/tip")["t"] - taken).max() > 5e-3
    assert np.abs(aligned(recording, "/tip") - taken).max() < 1e-5
    with pytest.raises(MissingStream, match="/pressure"):
        aligned(recording, "/pressure")


def test_a_step_of_wall_time_by_an_hour_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = state(rule=Window(0.2, 0.5), topics=("/pressure",))

    def run(path: Path, step: float) -> tuple[str, list[int]]:
        with monkeypatch.context() as patch, Recorder(path, start_wall_ns=10**18) as recorder:
            real, real_ns = time.time, time.time_ns
            for k in range(200):
                if k == 60:
                    patch.setattr(time, "time", lambda: real() + step)
                    patch.setattr(time, "time_ns", lambda: real_ns() + round(step * 1e9))
                recorder.push("/pressure", k * 0.01, (TARGETS, tuple(p + k for p in TARGETS)))
            row = conclude(recorder.buffers, asked)
        return row.to_json(), Recording.open(path).log_times("/pressure").tolist()

    plain = run(tmp_path / "plain.mcap", 0.0)
    assert run(tmp_path / "forward.mcap", 3600.0) == plain == run(tmp_path / "back.mcap", -3600.0)
