"""Views: what viewers show, in published schemas and not too often."""

import math
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from recordings.file.reader import Recording
from recordings.file.recover import recover
from recordings.file.writer import Recorder


def test_pose_markers_and_joints_come_at_thirty_a_second_of_rig_time(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Recorder(path, start_wall_ns=10**18, markers=3) as recorder:
        for k in range(500):
            t = k * 0.004
            markers = ((0.1, 0.2, 0.3), (math.nan,) * 3, (0.4, 0.5, 0.6))
            recorder.push("/tip", t, (t, k, (1.0, 2.0, 3.0), (0.5, 0.5, 0.5, 0.5), 0.0, k < 400, markers))
            recorder.push("/arm", t, (t, tuple(range(6)), (0.0,) * 6, (0.0,) * 6, 1, True))
    counts = recorder.counts()
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found: dict[str, list[tuple[int, object]]] = {}
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            if schema is not None and schema.name.startswith("foxglove.") and channel.topic != "/log":
                found.setdefault(f"{channel.topic} {schema.name}", []).append((message.log_time, decoded))
    assert set(found) == {
        "/tip/pose foxglove.PoseInFrame",
        "/tip/markers foxglove.PosesInFrame",
        "/arm/joints foxglove.JointStates",
    }
    for messages in found.values():
        assert np.diff([time for time, _ in messages]).min() >= 1e9 / 30 - 1
    assert len(found["/arm/joints foxglove.JointStates"]) == len(found["/tip/markers foxglove.PosesInFrame"]) == 56
    poses = found["/tip/markers foxglove.PosesInFrame"][0][1].poses  # type: ignore[attr-defined]
    assert [(p.position.x, p.position.y, p.position.z) for p in poses] == [(0.1, 0.2, 0.3), (0.4, 0.5, 0.6)]
    joints = found["/arm/joints foxglove.JointStates"][0][1].joints  # type: ignore[attr-defined]
    assert [(j.name, j.position) for j in joints][:2] == [("shoulder_pan", 0.0), ("shoulder_lift", 1.0)]
    # Where the tip was not tracked there is no pose; that is no loss.
    assert len(found["/tip/pose foxglove.PoseInFrame"]) == 45
    assert counts["/tip/pose"].complete and counts["/tip/pose"].written == 45


def test_a_recording_with_views_that_saw_nothing_is_recovered_as_complete(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=10**18) as recorder:
        for k in range(20):
            recorder.push("/tip", k * 0.1, (0.0, k, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), 0.0, k % 2 == 0, ()))
    assert recover(tmp_path / "a.mcap", tmp_path / "b.mcap").complete
    assert len(Recording.open(tmp_path / "b.mcap").log_times("/tip/pose")) == 10
