"""A recording that is deleted, renamed, replaced or truncated while it is written goes on in a rescue file."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from synthetic_run import Run

from recordings.campaign.replay import metadata
from recordings.errors import WriteFailed
from recordings.file.journal import Journal, read
from recordings.file.reader import Recording
from recordings.file.recover import recover
from recordings.file.verify import verify
from recordings.file.writer import Recorder
from tests.simulated.bench import wait_until

Begun = tuple[Recorder, Journal]
RUN = Run(duration=4.0)
HALF = 2.0


@pytest.fixture
def begun(tmp_path: Path) -> Iterator[Begun]:
    """Half a recording in out/run.mcap, which may be rescued into the folder rig."""
    for name in ("out", "rig"):
        (tmp_path / name).mkdir()
    with Journal.begin(tmp_path / "out" / "run.mcap", "bending") as journal:
        recorder = Recorder(
            tmp_path / "out" / "run.mcap", start_wall_ns=10**18, attachments={"rig.yaml": b"x: 1\n"}, markers=2, journal=journal,
            metadata=metadata(journal.campaign, journal.path.name, 1), rescue=[tmp_path / "rig"],
        )  # fmt: skip
        push(recorder, first=True)
        journal.step(1, 1)
        yield recorder, journal


def push(recorder: Recorder, first: bool) -> None:
    for topic, t, values in RUN.messages():
        if (t < HALF) is first:
            recorder.push(topic, t, values)
    recorder.sync()


def replace(file: Path) -> None:
    other = file.with_name("new")
    other.write_bytes(b"something else")
    os.replace(other, file)


LOSSLESS: dict[str, Callable[[Path], object]] = {
    "deleted": Path.unlink,
    "renamed": lambda file: file.rename(file.with_name("other.mcap")),
    "folder deleted": lambda file: shutil.rmtree(file.parent),
    "folder renamed": lambda file: file.parent.rename(file.parent.with_name("moved")),
    "replaced": replace,
    "now a folder": lambda file: (file.unlink(), file.mkdir()),
}


@pytest.mark.parametrize("harm", LOSSLESS.values(), ids=LOSSLESS)
def test_a_recording_that_lost_its_place_is_whole_in_the_rescue_file(
    begun: Begun, harm: Callable[[Path], None], tmp_path: Path
) -> None:
    recorder, journal = begun
    harm(tmp_path / "out" / "run.mcap")
    wait_until(lambda: recorder.displaced)
    push(recorder, first=False)
    journal.done(1, 1)
    counts = recorder.close("completed")

    file = tmp_path / "rig" / "run-rescue.mcap"
    assert recorder.path == file and verify(file).ok
    found = Recording.open(file)
    assert found.outcome == "completed" and found.attachments == {"rig.yaml": b"x: 1\n"}
    for topic in recorder.messages:
        assert len(found.stream(topic)) == sum(name == topic for name, *_ in RUN.messages())
        assert counts[topic].dropped == 0
    (text,) = recorder.displaced
    assert str(tmp_path / "out" / "run.mcap") in text and str(file) in text and "nothing of it is lost" in text
    assert [line.text for line in found.log if line.level == "error"] == [text]
    assert found.metadata["rescue"]["instead_of"] == str(tmp_path / "out" / "run.mcap")
    progress = read(file.with_name(found.metadata["campaign"]["journal"]))
    assert progress.recordings == ((file.name, 1),) and progress.done == {1: 1}


@pytest.mark.parametrize("left", [0, 5, 20_000])
def test_what_a_truncated_recording_still_holds_is_kept_and_the_rest_is_told(begun: Begun, left: int, tmp_path: Path) -> None:
    recorder, _ = begun
    size = (tmp_path / "out" / "run.mcap").stat().st_size
    os.truncate(tmp_path / "out" / "run.mcap", left)
    wait_until(lambda: recorder.displaced)
    push(recorder, first=False)
    counts = recorder.close("completed")
    assert verify(recorder.path).ok
    found = Recording.open(recorder.path)
    for topic in recorder.messages:
        sent = [t for name, t, _ in RUN.messages() if name == topic]
        times = found.stream(topic)["t"].tolist()
        assert len(times) == counts[topic].written and counts[topic].dropped == len(sent) - len(times)
        assert [t for t in times if t >= HALF] == pytest.approx([t for t in sent if t >= HALF])
    assert f"was truncated to {left} of" in recorder.displaced[0] and "messages are lost" in recorder.displaced[0]
    assert size > 20_000 and counts["/force"].dropped > 0


def test_a_recording_lost_in_the_moment_of_closing_is_finished_in_the_rescue_file(
    begun: Begun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder, _ = begun
    finish = recorder._mcap.finish

    def lose() -> None:
        finish()
        shutil.rmtree(tmp_path / "out")

    monkeypatch.setattr(recorder._mcap, "finish", lose)
    recorder.close("completed")
    assert recorder.path.parent == tmp_path / "rig" and verify(recorder.path).ok
    assert Recording.open(recorder.path).outcome == "completed"


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder for temporary files, before a recorder asks for it."""
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    return tmp_path / "tmp"


def test_a_rescue_file_goes_into_the_temporary_folder_where_the_rig_s_cannot_be_written(
    temporary: Path, begun: Begun, tmp_path: Path
) -> None:
    recorder, _ = begun
    shutil.rmtree(tmp_path / "rig")
    shutil.rmtree(tmp_path / "out")
    wait_until(lambda: recorder.displaced)
    assert recorder.path == temporary / "run-rescue.mcap"
    recorder.path.unlink()  # and once more
    wait_until(lambda: len(recorder.displaced) == 2)
    shutil.rmtree(temporary)
    with pytest.raises(WriteFailed, match="no rescue file can be written"):
        recorder.close("completed")


def test_a_rescue_file_of_a_killed_program_can_be_recovered(begun: Begun, tmp_path: Path) -> None:
    recorder, _ = begun
    os.truncate(tmp_path / "out" / "run.mcap", 0)
    wait_until(lambda: recorder.displaced)
    push(recorder, first=False)
    cut = tmp_path / "cut.mcap"
    shutil.copy(recorder.path, cut)
    recorder.close("completed")
    assert recover(cut).holes == 0
    sent = sum(name == "/force" and t >= HALF for name, t, _ in RUN.messages())
    assert len(Recording.open(tmp_path / "cut-recovered.mcap").stream("/force")) == sent


@pytest.mark.parametrize("harm", [Path.unlink, lambda file: os.truncate(file, 0)])
def test_a_journal_that_is_lost_is_written_anew_in_its_place(begun: Begun, harm: Callable[[Path], None], tmp_path: Path) -> None:
    recorder, journal = begun
    harm(journal.path)
    journal.step(1, 2)
    wait_until(lambda: recorder.displaced)
    journal.done(1, 2)
    recorder.close("completed")
    assert recorder.path == tmp_path / "out" / "run.mcap"
    assert read(tmp_path / "out" / "run.journal").done == {1: 2}
    assert "run.journal" in recorder.displaced[0]


def test_a_journal_that_was_replaced_is_left_alone_and_both_go_on_elsewhere(begun: Begun, tmp_path: Path) -> None:
    recorder, journal = begun
    replace(tmp_path / "out" / "run.journal")
    wait_until(lambda: recorder.displaced)
    recorder.close("completed")
    assert (tmp_path / "out" / "run.journal").read_bytes() == b"something else"
    assert read(tmp_path / "rig" / "run-rescue.journal").recordings == (("run-rescue.mcap", 1),)
