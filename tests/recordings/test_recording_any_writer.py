"""Files of any writer: counts, contents and verdict are right for every combination of what the format leaves open."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader
from mcap.records import Message
from mcap_files import ATTACHED, FEATURES, INPUTS, NOTED, build, combinations

from recordings.campaign.info import info
from recordings.errors import NotARecording
from recordings.file.recover import recover
from recordings.file.tail import Tail
from recordings.file.verify import INTACT, UNCOVERED, verify


def held(path: Path) -> list[tuple[int, int, bytes]]:
    """Messages by the library's reader."""
    with open(path, "rb") as file:
        return [(m.log_time, m.sequence, m.data) for _, _, m in NonSeekingReader(file).iter_messages()]


def followed(path: Path) -> int:
    with Tail(path) as tail:
        return sum(len(piece.messages) for pieces in iter(tail.read, []) for piece in pieces)


def check(path: Path, kind: str, checksums: bool) -> None:
    count = sum(isinstance(record, Message) for record in INPUTS[kind])
    attached = {r.name: len(r.data) for r in INPUTS[kind] if r is ATTACHED}
    notes = [r for r in INPUTS[kind] if r is NOTED]
    found = verify(path)
    assert (found.problems, found.messages) == ((), count)
    assert found.verdict == (INTACT if checksums else UNCOVERED)
    seen = info(path)
    assert seen.finished and seen.complete and seen.attachments == attached and len(seen.metadata) == len(notes)
    assert sum(s.timing.count for s in seen.streams.values()) == count and len(seen.streams) == bool(count)
    assert seen.states == seen.rows == 0
    assert followed(path) == count


@pytest.mark.parametrize("every", [11, pytest.param(1, marks=pytest.mark.long)])
@pytest.mark.parametrize("checksums", [False, True], ids=["no checksums", "checksums"])
@pytest.mark.parametrize("kind", INPUTS)
def test_every_combination_of_features_is_read_right(tmp_path: Path, kind: str, checksums: bool, every: int) -> None:
    path = tmp_path / "a.mcap"
    for number, features in enumerate(combinations()):
        if number % every == 0:
            path.write_bytes(build(INPUTS[kind], features, checksums=checksums).data)
            try:
                check(path, kind, checksums)
            except AssertionError as error:
                raise AssertionError(f"{sorted(features)}: {error}") from error


@pytest.mark.parametrize("every", [61, pytest.param(5, marks=pytest.mark.long)])
@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_recover_keeps_all_of_every_combination_and_takes_its_own_output(
    tmp_path: Path, compression: str, every: int
) -> None:
    written = [(r.log_time, r.sequence, r.data) for r in INPUTS["everything"] if isinstance(r, Message)]
    source, once, twice = (tmp_path / f"{name}.mcap" for name in ("source", "once", "twice"))
    for number, features in enumerate(combinations()):
        if number % every:
            continue
        source.write_bytes(build(INPUTS["everything"], features, compression, bool(number % 2), per_chunk=2).data)
        first = recover(source, once)
        assert first.complete and first.messages == {"example": 7}, sorted(features)
        assert held(once) == written and verify(once).verdict == INTACT
        assert info(once).attachments == {"my file": 1024} and info(once).outcome is None
        second = recover(once, twice)
        assert second.complete and held(twice) == written
        for made in (once, twice):
            made.unlink()


def test_every_cut_of_a_file_without_chunks_keeps_the_messages_before_it(tmp_path: Path) -> None:
    for features in (frozenset(), frozenset(FEATURES) - {"chunks"}):
        data = build(INPUTS["everything"], features).data
        ends = [data.index(b'{"x": %d}' % n) + 8 for n in range(7)]
        for cut in range(60, len(data), 5):
            (tmp_path / "a.mcap").write_bytes(data[:cut])
            (tmp_path / "b.mcap").unlink(missing_ok=True)
            kept = recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
            assert sum(kept.messages.values()) == sum(end <= cut for end in ends), cut
            if cut % 20 == 0:
                assert not verify(tmp_path / "a.mcap").ok and not info(tmp_path / "a.mcap").finished


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
@pytest.mark.parametrize(
    "features", [frozenset(FEATURES), frozenset(FEATURES) - {"extra bytes"}, frozenset({"chunks"})]
)
def test_no_changed_bit_of_a_file_with_checksums_is_missed(
    tmp_path: Path, features: frozenset[str], compression: str
) -> None:
    data = bytearray(build(INPUTS["everything"], features, compression, True, per_chunk=3).data)
    path = tmp_path / "a.mcap"
    for at in range(len(data)):
        if 700 < at < 1500 and at % 40:  # the long attachment
            continue
        data[at] ^= 1 << at % 8
        path.write_bytes(data)
        data[at] ^= 1 << at % 8
        try:
            assert not verify(path).ok, at
        except NotARecording:
            assert at < 8
