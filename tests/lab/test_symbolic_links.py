"""Whatever writes several files into a folder that a person names writes none of them through a symbolic link in it."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest
from diagnosed_case import campaign, folder

from lab.cli import main

RECORDING = Path(__file__).parent.parent / "recordings" / "data" / "bending-schema-1.mcap"
PRECIOUS = "somebody's only copy"


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return folder(tmp_path_factory.mktemp("case") / "case", campaign({}, repeats=1, lengths=(0.0, 0.2)))


@pytest.mark.parametrize(
    "words",
    [
        ("export", "RECORDING"),
        ("export", "RECORDING", "--parquet"),
        ("export", "RECORDING", "--mat"),
        ("export", "RECORDING", "--case"),
        ("export", "RECORDING", "--crate"),
        ("export", "CASE", "RECORDING", "--crate"),
        ("export", "CASE", "--mat"),
        ("compare", "CASE"),
        ("fit", "CASE"),
        ("effects",),
        ("paper",),
    ],
    ids=" ".join,
)
def test_no_file_is_written_through_a_link(words: Sequence[str], case: Path, tmp_path: Path) -> None:
    told = [{"RECORDING": str(RECORDING), "CASE": str(case)}.get(word, word) for word in words]
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    elsewhere.mkdir()
    assert main([*told, "--out", str(out)]) == 0
    names = [path.name for path in out.iterdir() if path.is_file()]
    assert names
    for name in names:
        (out / name).unlink()
        (elsewhere / name).write_text(PRECIOUS)
        (out / name).symlink_to(elsewhere / name)
    assert main([*told, "--out", str(out)]) == 0
    assert all((elsewhere / name).read_text() == PRECIOUS for name in names)
    assert not any((out / name).is_symlink() for name in names)


def test_no_folder_of_a_recording_is_a_link(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for file in files:
        shutil.copy(RECORDING, file)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "b").symlink_to(tmp_path / "elsewhere")
    assert main(["export", *map(str, files), "--out", str(tmp_path / "out")]) == 1
    assert "symbolic link" in capsys.readouterr().err and not list((tmp_path / "elsewhere").iterdir())
