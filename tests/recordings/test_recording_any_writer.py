"""Files of any writer: counts, contents and verdict are right for every combination of what the format leaves open."""

import itertools
import struct
from pathlib import Path
from typing import Any

import pytest
from mcap.records import Channel, Message
from mcap_files import ATTACHED, CHANNEL, FEATURES, INPUTS, NOTED, ONE, build, chunk, combinations, message, whole, written
from synthetic_run import held

from recordings.campaign.info import info
from recordings.errors import NotARecording, Oversized
from recordings.file import budget
from recordings.file.reader import Recording
from recordings.file.recover import recover
from recordings.file.tail import Tail
from recordings.file.verify import INTACT, UNCOVERED, verify


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
    with Tail(path) as tail:
        assert sum(len(piece.messages) for pieces in iter(tail.read, []) for piece in pieces) == count


@pytest.mark.parametrize("every", [23, pytest.param(1, marks=pytest.mark.long)])
@pytest.mark.parametrize("checksums", [False, True], ids=["no checksums", "checksums"])
@pytest.mark.parametrize("kind", INPUTS)
def test_every_combination_of_features_is_read_right(tmp_path: Path, kind: str, checksums: bool, every: int) -> None:
    path = tmp_path / "a.mcap"
    for number, features in enumerate(combinations()):
        if number % every == 0:
            path.write_bytes(build(INPUTS[kind], features, checksums=checksums))
            try:
                check(path, kind, checksums)
            except AssertionError as error:
                raise AssertionError(f"{sorted(features)}: {error}") from error


@pytest.mark.parametrize("every", [61, pytest.param(5, marks=pytest.mark.long)])
@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_recover_keeps_all_of_every_combination_and_takes_its_own_output(tmp_path: Path, compression: str, every: int) -> None:
    written = [("example", r.log_time, r.sequence, r.data) for r in INPUTS["everything"] if isinstance(r, Message)]
    source, once, twice = (tmp_path / f"{name}.mcap" for name in ("source", "once", "twice"))
    for number, features in enumerate(combinations()):
        if number % every:
            continue
        source.write_bytes(build(INPUTS["everything"], features, compression, bool(number % 2), 100))
        first = recover(source, once)
        assert first.complete and first.messages == {"example": 7}, sorted(features)
        assert held(once) == written and verify(once).verdict == INTACT
        seen = info(once)
        assert seen.attachments == {"my file": 1024} and seen.outcome is None
        assert seen.streams["example"].lost is None  # the source states no losses, so none are known
        second = recover(once, twice)
        assert second.complete and held(twice) == written
        for made in (once, twice):
            made.unlink()


@pytest.mark.parametrize("every", [29, pytest.param(11, marks=pytest.mark.long)])
def test_every_cut_of_a_file_without_chunks_keeps_the_messages_before_it(tmp_path: Path, every: int) -> None:
    for features in (frozenset(), frozenset(FEATURES) - {"chunks"}):
        data = build(INPUTS["everything"], features)
        ends = [data.index(b'{"x": %d}' % n) + 8 for n in range(7)]
        for cut in range(60, len(data), every):
            (tmp_path / "a.mcap").write_bytes(data[:cut])
            (tmp_path / "b.mcap").unlink(missing_ok=True)
            kept = recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
            assert sum(kept.messages.values()) == sum(end <= cut for end in ends), cut
            if cut % 3 == 0:
                assert not verify(tmp_path / "a.mcap").ok and not info(tmp_path / "a.mcap").finished


@pytest.mark.parametrize("every", [13, pytest.param(1, marks=pytest.mark.long)])
@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
@pytest.mark.parametrize("features", [frozenset(FEATURES), frozenset(FEATURES) - {"extra bytes"}, frozenset({"chunks"})])
def test_no_changed_bit_of_a_file_with_checksums_is_missed(
    tmp_path: Path, features: frozenset[str], compression: str, every: int
) -> None:
    data = bytearray(build(INPUTS["everything"], features, compression, True, 140))
    path = tmp_path / "a.mcap"
    for at in range(0, len(data), every):
        if 700 < at < 1500 and at % 40:  # the long attachment
            continue
        data[at] ^= 1 << at % 8
        path.write_bytes(data)
        data[at] ^= 1 << at % 8
        try:
            assert not verify(path).ok, at
        except NotARecording:
            assert at < 8


# ------------------------------------------------------------------ writers
OPTIONS = (
    "use_chunks", "emit_statistics", "emit_summary_offsets", "emit_message_indexes", "emit_chunk_indexes", "repeat_channels",
    "repeat_schemas", "calculate_chunk_crcs", "calculate_data_section_crc", "calculate_summary_section_crc",
)  # fmt: skip


@pytest.mark.parametrize("compression", ["Lz4", "Zstd", None])
def test_every_option_of_foxglove(tmp_path: Path, compression: str | None) -> None:
    foxglove = pytest.importorskip("foxglove")
    from foxglove.mcap import MCAPCompression, MCAPWriteOptions

    packed = None if compression is None else getattr(MCAPCompression, compression)
    for number, off in enumerate(itertools.chain([()], itertools.combinations(OPTIONS, 1), itertools.combinations(OPTIONS, 2))):
        path, context = tmp_path / f"{number}.mcap", foxglove.Context()
        options = MCAPWriteOptions(compression=packed, chunk_size=500, **dict.fromkeys(off, False))
        with foxglove.open_mcap(path, context=context, writer_options=options):
            for topic in ("/a", "/b"):
                channel = foxglove.Channel(topic, message_encoding="json", context=context)
                for k in range(20):
                    channel.log({"x": k}, log_time=k)
        found = verify(path)
        assert found.problems == () and found.messages == 40, off
        # Without checksums of chunks, this writer leaves their contents out of that of the data section.
        uncovered = {*OPTIONS[-2:], OPTIONS[-3]} if "use_chunks" not in off else {*OPTIONS[-2:]}
        assert (found.verdict == UNCOVERED) == bool(uncovered & set(off)), off
        assert {topic: s.timing.count for topic, s in info(path).streams.items()} == {"/a": 20, "/b": 20}, off


# ------------------------------------------------------------------ damage
MESSAGES = [message(k) for k in range(10)]


def chunked(*records: object, **stated: Any) -> bytes:
    return chunk(b"".join(map(written, records)), **stated)


DEFINED = written(ONE) + written(CHANNEL)
SHORT = struct.pack("<BQ", 5, 4) + b"abcd"
DAMAGE = {
    "a chunk in an unknown compression": (whole(DEFINED, chunked(*MESSAGES), chunked(*MESSAGES, compression="br")), 10, "'br'"),
    "a chunk that fails its checksum": (whole(DEFINED, chunked(*MESSAGES), chunked(*MESSAGES, crc=1)), 10, "checksum"),
    "a chunk of another size": (whole(DEFINED, *map(written, MESSAGES), chunked(ONE, size=10**12)), 10, "10000000000"),
    "a packed chunk of another size": (
        whole(DEFINED, *map(written, MESSAGES), chunked(*MESSAGES, compression="lz4", size=10**12)), 10, "10000000000"),
    "metadata inside a chunk": (whole(DEFINED, chunked(*MESSAGES[:4], NOTED, *MESSAGES[4:], crc=0)), 10, ""),
    "a schema that is missing": (whole(written(CHANNEL), *map(written, MESSAGES)), 10, "schema 1, which is missing"),
    "a channel that is missing": (whole(DEFINED, *map(written, MESSAGES), written(message(1, 9))), 10, "1 messages are of"),
    "an attachment that was changed": (
        whole(DEFINED, *map(written, MESSAGES), written(ATTACHED).replace(b"\x01\x02\x03", b"\x01\x02\x02")), 10, "my file"),
    "metadata that is no text": (
        whole(DEFINED, written(NOTED).replace(b"foo", b"\xff\xfe\xfd"), *map(written, MESSAGES)), 10, "cannot be parsed"),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGE)
def test_what_is_damaged_is_named_and_the_rest_is_counted_and_kept(tmp_path: Path, name: str) -> None:
    data, count, said = DAMAGE[name]
    path, copy, again = (tmp_path / f"{name}.mcap" for name in "abc")
    path.write_bytes(data)
    assert not verify(path).ok
    kept = recover(path, copy)
    assert sum(kept.messages.values()) == count and not kept.complete and not kept.oversized
    assert verify(copy).verdict == INTACT and info(copy).complete
    second = recover(copy, again)
    assert second.complete and second.messages == kept.messages
    seen = info(path)
    assert seen.finished and sum(s.timing.count for s in seen.streams.values()) == count
    if said:  # what stands in a chunk against the rules misleads nobody who counts messages
        assert not seen.complete and said in " ".join(seen.damage)


def test_a_broken_chunk_keeps_the_messages_before_what_makes_no_sense(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    cut = b"".join(map(written, MESSAGES))[:-3]
    short = DEFINED + b"".join(map(written, MESSAGES[:5])) + SHORT + b"".join(map(written, MESSAGES[5:]))
    for raw, count in ((DEFINED + cut, 9), (short, 10)):
        path.write_bytes(whole(chunk(raw)))
        (seen,) = info(path).streams.values()
        assert seen.timing.count == count and not info(path).complete
        (tmp_path / "b.mcap").unlink(missing_ok=True)
        assert recover(path, tmp_path / "b.mcap").messages == {"example": count}


def test_times_of_any_size_are_kept(tmp_path: Path) -> None:
    times = [2**64 - 1, 0, 2**63]
    path, copy = tmp_path / "a.mcap", tmp_path / "b.mcap"
    path.write_bytes(whole(DEFINED, *(written(Message(1, t, b"{}", t, k)) for k, t in enumerate(times))))
    assert recover(path, copy).complete and [t for _, t, _, _ in held(copy)] == sorted(times)
    assert verify(path).messages == 3 == info(path).streams["example"].timing.count
    assert info(path).duration == pytest.approx(2**64 / 1e9) and info(path).start.startswith("1970-01-01")


# ------------------------------------------------------------------ identity
def test_channels_of_one_topic_are_counted_together_and_kept_apart(tmp_path: Path) -> None:
    twice = [Channel(n, "/tip", encoding, {"n": str(n)}, 0) for n, encoding in ((1, "json"), (2, "json"), (3, "cdr"))]
    messages = [message(k, 1 + k % 3) for k in range(10)]
    for features in (frozenset({"chunks"}), frozenset()):
        path, copy = tmp_path / "a.mcap", tmp_path / "b.mcap"
        path.write_bytes(build([*twice, *messages], features, checksums=True))
        copy.unlink(missing_ok=True)
        assert recover(path, copy).messages == {"/tip": 10}
        for file in (path, copy):
            assert verify(file).verdict == INTACT and verify(file).messages == 10
            (seen,) = info(file).streams.values()
            assert (seen.timing.count, seen.channels) == (10, 3)
            assert len(Recording.open(file).contents.channels) == 3


def test_attachments_and_metadata_of_one_name_do_not_replace_each_other(tmp_path: Path) -> None:
    path, copy = tmp_path / "a.mcap", tmp_path / "b.mcap"
    path.write_bytes(build([ATTACHED, NOTED, ATTACHED, NOTED], frozenset(FEATURES)))
    recover(path, copy)
    for file in (path, copy):
        seen = info(file)
        assert seen.attachments == {"my file": 1024, "my file (2)": 1024}
        assert [name for name in seen.metadata if name.startswith("my notes")] == ["my notes", "my notes (2)"]


def test_a_channel_that_is_described_twice_differently_is_damage(tmp_path: Path) -> None:
    twice = [Channel(1, "/a", "json", {}, 0), message(0), Channel(1, "/b", "json", {}, 0), message(1)]
    (tmp_path / "a.mcap").write_bytes(whole(*map(written, twice)))
    (problem,) = verify(tmp_path / "a.mcap").problems
    assert "describes channel 1 twice, and differently" in problem.text


# ------------------------------------------------------------------ size
def test_a_file_of_many_topics_is_read(tmp_path: Path) -> None:
    channels = [Channel(n, f"/robot/part_{n}/state", "json", {"qos": "reliable"}, 0) for n in range(1, 3000)]
    path = tmp_path / "a.mcap"
    path.write_bytes(build([*channels, *(message(k, k + 1) for k in range(2999))], frozenset({"chunks"}), "zstd"))
    assert len(info(path).streams) == 2999 and verify(path).messages == 2999
    assert recover(path, tmp_path / "b.mcap").complete


def test_a_limit_is_named_with_the_option_that_lifts_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    channel, count = Channel(1, "/x", "json", {}, 0), 2000
    many = [Message(1, k, b"0" * 10_000, k, k) for k in range(count)]
    path = tmp_path / "a.mcap"
    path.write_bytes(build([channel, *many], frozenset({"chunks"}), "zstd", chunk_size=2_000_000))
    assert path.stat().st_size < 400_000
    for way in (info, verify):
        with pytest.raises(Oversized, match="limit for a file of .* bytes; .*--any-size lifts the limit"):
            way(path)
    held = recover(path, tmp_path / "b.mcap")
    assert "--any-size" in held.oversized and not held.complete
    monkeypatch.setattr(budget, "_lifted", False)
    budget.lift()
    assert verify(path).messages == count == info(path).streams["/x"].timing.count


# ------------------------------------------------------------------ tolerance
@pytest.mark.parametrize("features", [frozenset({"chunks"}), frozenset()], ids=["chunks", "no chunks"])
def test_zeros_behind_what_was_written_cost_nothing(tmp_path: Path, features: frozenset[str]) -> None:
    data = build(INPUTS["everything"], features, chunk_size=60)
    kept = data[: data.index(struct.pack("<BQ", 15, 4))]
    (tmp_path / "a.mcap").write_bytes(kept + bytes(100_000))
    found = info(tmp_path / "a.mcap")
    assert not found.finished and found.readable == len(kept)
    assert sum(recover(tmp_path / "a.mcap", tmp_path / "b.mcap").messages.values()) == 7


def test_records_whose_length_is_wrong_cost_at_most_themselves(tmp_path: Path) -> None:
    path, copy = tmp_path / "a.mcap", tmp_path / "b.mcap"
    for features in (frozenset({"chunks"}), frozenset(), frozenset(FEATURES)):
        data = build(INPUTS["everything"], features, chunk_size=60)
        starts = [m for m in range(8, len(data) - 40) if data[m] in (4, 5, 6, 7, 9, 12) and record_at(data, m)]
        assert len(starts) > 6
        for start in starts:
            for bit in (0, 13, 17, 40):
                broken = bytearray(data)
                broken[start + 1 + bit // 8] ^= 1 << bit % 8
                path.write_bytes(broken)
                copy.unlink(missing_ok=True)
                kept = recover(path, copy)
                most = 2 if data[start] == 6 else 7 if data[start] == 4 else 1
                assert sum(kept.messages.values()) >= 7 - most, (start, bit)
                assert kept.holes and not verify(path).ok


def record_at(data: bytes, at: int) -> bool:
    """Whether a record of the data section stands here."""
    place = 8
    while place < at:
        place += 9 + struct.unpack_from("<Q", data, place + 1)[0]
    return place == at and at < data.index(struct.pack("<BQ", 15, 4))


def test_an_attachment_that_was_changed_is_left_out_and_one_without_checksum_is_kept(tmp_path: Path) -> None:
    for checksums, kept in ((True, {}), (False, {"my file": 1024})):
        data = bytearray(build([ATTACHED], frozenset(FEATURES), checksums=checksums))
        data[400] ^= 1
        (tmp_path / "a.mcap").write_bytes(data)
        (tmp_path / "b.mcap").unlink(missing_ok=True)
        assert recover(tmp_path / "a.mcap", tmp_path / "b.mcap").complete != checksums
        assert info(tmp_path / "b.mcap").attachments == kept
