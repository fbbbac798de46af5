"""Pressures and tip in two files, in two tables of one, or in rows that take turns: joined in time, and asked about."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import Cli, refused
from foreign import ROBOT, by_map, plain, pressures, through, tips

from benchmarks.faults.foreign_tables import PLATEAUS, sweep
from lab.files.inputs import unconfirmed_guesses
from lab.files.map_file import Source
from lab.imports.formats import read
from lab.imports.table import Imported
from recordings.table_file import read_csv

ROWS = np.array(sweep(60, 0.05))
"""s, kPa, mm: holds of 3 s."""
TIP = ("Time [s]", "Tip X [mm]", "Tip Y [mm]", "Tip Z [mm]")
PRESSURES = ("Time [s]", "P1 [kPa]", "P2 [kPa]", "P3 [kPa]")
TIPS = (4, 5, 6)
COLUMNS = {"t": TIP[0], "p1": PRESSURES[1], "p2": PRESSURES[2], "p3": PRESSURES[3], "x": TIP[1], "y": TIP[2], "z": TIP[3]}
MAP = {"columns": plain(**COLUMNS), "states": {"plateaus": {"steady": "1 kPa"}}, "trials": {"begin": "rest"}}
HELD = np.array([ROWS[k] for k in range(30, len(ROWS), 60)])
"""Middles of the holds."""


def table(path: Path, columns: tuple[int, ...], head: tuple[str, ...], rows: np.ndarray = ROWS,
          time: Callable[[float], str] = lambda t: f"{t:.3f}") -> Path:  # fmt: skip
    lines = [",".join([time(r[0]), *(f"{r[k]:.3f}" for k in columns)]) for r in rows]
    path.write_text("\n".join([",".join(head), *lines]) + "\n")
    return path


def two(folder: Path, logger: np.ndarray = ROWS) -> list[Path]:
    return [table(folder / "mocap.csv", TIPS, TIP), table(folder / "logger.csv", (1, 2, 3), PRESSURES, logger)]


def slower(step: float) -> np.ndarray:
    """The same sweep at another period."""
    t = np.arange(0.0, ROWS[-1, 0], step)
    return np.column_stack([t, *(np.interp(t, ROWS[:, 0], c) for c in ROWS.T[1:])])


def moved(rows: np.ndarray, by: float) -> np.ndarray:
    return np.column_stack([rows[:, 0] + by, rows[:, 1:]])


def same(made: Imported) -> None:
    """All holds, with their pressures and tips."""
    assert len(made.table) == PLATEAUS
    kept = [k for k in range(30) if k % 5 != 4 or k == 29]  # a last rest and the next first one are one state
    assert pressures(made.table) == pytest.approx(HELD[kept, 1:4], abs=0.3)
    assert tips(made.table) == pytest.approx(HELD[kept, 4:], abs=0.3)


def day(t: float) -> str:
    return (datetime(2026, 3, 3, 9) + timedelta(seconds=t)).isoformat(sep=" ", timespec="milliseconds")


# ------------------------------------------------------------------ two files
@pytest.mark.parametrize("step", [0.05, 0.17, 0.01])
def test_pressures_and_tip_of_two_files_are_one_table_and_their_clocks_are_asked_about(step: float, tmp_path: Path) -> None:
    made = by_map(two(tmp_path, slower(step)), **MAP)
    same(made)
    assert any("mocap.csv, joined by their clocks" in q and "do these agree?" in q for q in made.questions)
    assert not any("the tip moves" in q for q in made.questions)


def test_a_map_is_proposed_for_two_files_and_reads_them(tmp_path: Path, cli: Cli) -> None:
    files = [*map(str, two(tmp_path, slower(0.07)))]
    proposed = cli("import", *files, "--guess", "--robot", ROBOT, "--out", tmp_path / "map")
    assert "check: mocap.csv, joined by their clocks" in proposed.flat_err
    said = cli("import", *files, "--map", tmp_path / "map" / "map.yaml", "--out", tmp_path / "case")
    assert "check: mocap.csv, joined by" in said.flat_err and len(read_csv(tmp_path / "case" / "trials.csv")) == PLATEAUS
    (carried,) = unconfirmed_guesses([tmp_path / "case"])
    assert "joined by their clocks: do these agree?" in carried.text
    own_map = tmp_path / "case" / "map.yaml"
    own_map.write_text(own_map.read_text().replace("unconfirmed:", "confirmed:"))
    assert "check:" not in cli("import", *files, "--map", own_map, "--out", tmp_path / "case").err
    assert "confirmed:" in own_map.read_text() and not [*unconfirmed_guesses([tmp_path / "case"])]
    stated = (tmp_path / "map" / "map.yaml").read_text() + "files: {logger.csv: {source: {offset: 0}}, '*': {}}\n"
    (tmp_path / "map" / "map.yaml").write_text(stated)
    said = cli("import", *files, "--map", tmp_path / "map" / "map.yaml", "--out", tmp_path / "case", "--replace")
    assert "clocks" not in said.flat_err


def test_a_tracked_object_and_a_log_are_proposed_and_an_answered_clock_is_not_asked_again(tmp_path: Path, cli: Cli) -> None:
    head = "Objects\n20\n,,Global Angle Tip:Tip,,,,,,\nFrame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm\n"
    seen = [f"0,0,0,1,{r[4]:.3f},{r[5]:.3f},{r[6]:.3f}" if k % 50 else ",,,,,," for k, r in enumerate(ROWS)]
    object_file, log = tmp_path / "object.csv", tmp_path / "log.csv"
    object_file.write_text(head + "\n".join(f"{k},0,{cells}" for k, cells in enumerate(seen, 1)) + "\n")
    lines = [";".join(f"{v:.3f}" for v in (r[0], *r[1:4], *r[1:4])) for r in ROWS]
    log.write_text("\n".join(["time;set1;set2;set3;act1;act2;act3", *lines]) + "\n")
    map_file = tmp_path / "map" / "map.yaml"
    cli("import", object_file, log, "--guess", "--robot", ROBOT, "--out", map_file.parent)
    found = yaml.safe_load(map_file.read_text())
    assert found["columns"]["p2"]["column"] == "act2" and found["columns"]["x"]["unit"] == "mm"
    found["files"] = {"log.csv": {"source": {"offset": 0}}, "*": {}}
    map_file.write_text(yaml.safe_dump({k: v for k, v in found.items() if k != "unconfirmed"}))
    said = cli("import", object_file, log, "--map", map_file, "--out", tmp_path / "case").flat_err
    assert "clocks" not in said and "not a row of numbers" not in said and len(read_csv(tmp_path / "case/trials.csv")) == PLATEAUS
    log.write_text(log.read_text().replace("set", "q").replace("act", "r"))
    said = cli("import", object_file, log, "--guess", "--robot", ROBOT, "--out", tmp_path / "other", code=2).flat_err
    assert "no heading of these files names a pressure of each actuator" in said and "log.csv has 'time', 'q1'" in said
    sparse = log.read_text().splitlines()
    log.write_text("\n".join([*sparse[:9], *(f"{line.partition(';')[0]};;;;;;" for line in sparse[9:12]), *sparse[12:]]) + "\n")
    assert read(log, Source()).notes == ("3 lines with values in few of the 7 columns, the first line 10, taken as missing",)


@pytest.mark.parametrize("late", [2.4, -2.4])
def test_clocks_that_differ_are_seen_in_the_data_and_an_offset_puts_them_right(late: float, tmp_path: Path) -> None:
    files = two(tmp_path, moved(ROWS, -late))
    (question,) = [q for q in by_map(files, **MAP).questions if "the tip moves" in q]
    assert f"the tip moves 2.4 s {'after' if late > 0 else 'before'} the pressures" in question and f"add {late} to" in question
    made = by_map(files, **MAP, files={"logger.csv": {"source": {"offset": f"{late} s"}}, "*": {}})
    same(made)
    assert not any("the tip moves" in q for q in made.questions)


def test_files_with_dates_belong_together_that_have_time_in_common_and_others_are_named(tmp_path: Path) -> None:
    first, second = ROWS[ROWS[:, 0] < 45], ROWS[ROWS[:, 0] >= 45]
    head = ("Date", *TIP[1:])
    files = [table(tmp_path / f"take{k}.csv", TIPS, head, part, day) for k, part in ((1, first), (2, second))]
    for name, by in (("day", 0), ("next", 86400)):
        files.append(table(tmp_path / f"{name}.csv", (1, 2, 3), ("Clock", *PRESSURES[1:]), moved(ROWS, by), day))
    made = by_map(files, **MAP | {"columns": MAP["columns"] | {"t": {"column": "Date"}}})
    assert [s.path.name for s, _, _ in made.files] == ["take1.csv", "take2.csv"] and len(made.table) == PLATEAUS + 1
    assert made.table["p3"].max() == pytest.approx(HELD[:, 3].max() * 1e3, abs=300)
    assert [n for n in made.notes if "next.csv is not read: it does not overlap in time with 'take1.csv', 'take2.csv'" in n]


@pytest.mark.parametrize(
    ("time", "head", "by", "says"),
    [
        (day, "Date", 7200.0, r"do not overlap in time.*'logger.csv': \{source: \{offset: -7200\}\}.* or join them in time"),
        (day, "Date", 86400.0 * 30, r"do not overlap in time.* if both started together.*offset: -2592000"),
        (lambda t: f"{t:.3f}", "Time [s]", 500.0, r"mocap.csv \(0 .. 89.95 s\) and logger.csv \(500 .. 589.95 s\) do not"),
    ],
)
def test_files_without_a_time_in_common_are_refused_with_the_remedy(
    time: Callable[[float], str], head: str, by: float, says: str, tmp_path: Path
) -> None:
    files = [table(tmp_path / "mocap.csv", TIPS, (head, *TIP[1:]), ROWS, time)]
    files.append(table(tmp_path / "logger.csv", (1, 2, 3), (head, *PRESSURES[1:]), moved(ROWS, by), time))
    refused(says, by_map, files, **MAP | {"columns": MAP["columns"] | {"t": {"column": head}}})


def test_dates_and_a_clock_from_zero_need_a_stated_offset_and_runs_that_nothing_pairs_are_refused(tmp_path: Path) -> None:
    files = [table(tmp_path / "mocap.csv", TIPS, TIP)]
    files.append(table(tmp_path / "logger.csv", (1, 2, 3), ("Date", *PRESSURES[1:]), ROWS, day))
    text = f"Format Version,1.23,Take Name,A,Capture Start Time,{{}},Capture Start Frame,0\n{files[0].read_text()}"
    for start in ("2026-03-03 09.00.00.000 AM", "2026-03-03 9.00.00"):
        files[0].write_text(text.format(start))
        same(made := by_map(files, **MAP))
        assert f"mocap.csv: time 0 of mocap.csv is taken as its start, {start}, in the time zone of 'logger.csv'" in made.notes
    files[0].write_text(text.format("2026-13-03 09.00.00.000 AM"))
    told = refused("do not overlap in time", by_map, files, **MAP)
    offset = float(told.partition("offset: ")[2].partition("}")[0])
    same(by_map(files, **MAP, files={"logger.csv": {"source": {"offset": offset}}, "*": {}}))
    files = two(tmp_path)
    files.append(table(tmp_path / "more.csv", (1, 2, 3), PRESSURES))
    refused("no dates that show which belong together.* or join them in time first", by_map, files, **MAP)


def test_a_table_without_times_or_alone_or_below_another_is_told_to_be_joined_first(tmp_path: Path, cli: Cli) -> None:
    mocap, logger = two(tmp_path)
    logger.write_text("\n".join(line.partition(",")[2] for line in logger.read_text().splitlines()) + "\n")
    refused(r"logger.csv: no time column .* or join them in time first", by_map, [mocap, logger], **MAP)
    for file in (mocap, logger):
        said = cli("import", file, "--guess", "--robot", ROBOT, "--out", tmp_path / "map", code=2).flat_err
        assert "If they are in another file, give both, or join them in time first" in said
    (tmp_path / "a.csv").write_text("\n".join(["P1 [kPa],P2 [kPa]", "1,2", "2,3", "", "X [mm],Y [mm]", "3,4", "4,5"]) + "\n")
    refused("join them in time first", read, tmp_path / "a.csv", Source())


def test_a_gap_in_one_stream_is_not_filled_from_the_other(tmp_path: Path) -> None:
    made = by_map(two(tmp_path, ROWS[(ROWS[:, 0] < 31) | (ROWS[:, 0] > 40)]), **MAP)
    assert not ((made.table["t"] > 31.2) & (made.table["t"] < 39.8)).any() and len(made.table) < PLATEAUS
    assert any("rows have no pressure" in n for n in made.notes)


# ------------------------------------------------------------------ one file
def nexus(kind: str, rate: int, above: str, names: str, units: str, columns: tuple[int, ...], samples: int) -> list[str]:
    body = [
        f"{101 + k},{s}," + ",".join(f"{r[c]:.3f}" for c in columns) for k, r in enumerate(ROWS) for s in range(samples)
    ]  # fmt: skip
    return [kind, str(rate), above, names, units, *body]


DEVICES = nexus("Devices", 40, ",,Regulator - Pressure,,", "Frame,Sub Frame,P1,P2,P3", ",,kPa,kPa,kPa", (1, 2, 3), 2)
PATHS = nexus(
    "Trajectories", 20, ",,A:Tip,,,A:Base,,", "Frame,Sub Frame,X,Y,Z,X,Y,Z", ",,mm,mm,mm,mm,mm,mm", (4, 5, 6, 0, 0, 0), 1
)


@pytest.mark.parametrize("apart", [False, True])
def test_tables_of_nexus_below_each_other_or_apart_are_joined(apart: bool, tmp_path: Path, cli: Cli) -> None:
    parts = [DEVICES, PATHS] if apart else [[*DEVICES, "", *PATHS]]
    files = [tmp_path / f"{k}.csv" for k in range(len(parts))]
    for file, lines in zip(files, parts, strict=True):
        file.write_text("\n".join(lines) + "\n")
    cli("import", *files, "--guess", "--robot", ROBOT, "--out", tmp_path / "map")
    cli("import", *files, "--map", tmp_path / "map" / "map.yaml", "--out", tmp_path / "case")
    made = read_csv(tmp_path / "case" / "trials.csv")
    assert len(made) == PLATEAUS and np.diff(made["t"]).max() == pytest.approx(4.5, abs=0.6)
    assert made["p1"].max() == pytest.approx(HELD[:, 1].max() * 1e3, abs=300)


def test_streams_in_rows_of_their_own_are_joined_within_their_own_period(tmp_path: Path) -> None:
    lines = [",".join((*TIP, *PRESSURES[1:]))]
    for k, r in enumerate(ROWS):
        lines.append(f"{r[0]:.3f}," + ",".join(f"{v:.3f}" for v in r[4:]) + ",,,")
        if k % 2 and not 31 < r[0] < 40:
            lines.append(f"{r[0] + 0.012:.3f},,,," + ",".join(f"{v:.3f}" for v in r[1:4]))
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    found = read(tmp_path / "a.csv", Source())
    assert len(found) == len(ROWS) and any("2 groups of columns have values in separate rows" in n for n in found.notes)
    inside = (ROWS[:, 0] > 31.3) & (ROWS[:, 0] < 39.7)
    assert np.isnan(found.numbers["P1 [kPa]"][inside]).all()
    assert np.isfinite(found.numbers["P1 [kPa]"][(ROWS[:, 0] < 31) | (ROWS[:, 0] > 40.2)]).mean() > 0.99
    made = by_map(tmp_path / "a.csv", **MAP)
    assert made.table["p2"].max() == pytest.approx(HELD[:, 2].max() * 1e3, abs=300)


def test_values_under_their_names_in_rows_of_their_own_are_columns(tmp_path: Path) -> None:
    names = ("P1", "P2", "P3", "Tip X", "Tip Y", "Tip Z")
    lines = ["Time [s],Signal,Value,Unit"]
    for r in ROWS:
        lines += [f"{r[0] + k * 2e-3:.3f},{n},{r[k + 1]:.3f},{'kPa' if k < 3 else 'mm'}" for k, n in enumerate(names)]
    _, made = through(tmp_path / "a.csv", "\n".join(lines) + "\n")
    same(made)


def test_columns_that_are_blank_for_other_reasons_stay_as_they_are(tmp_path: Path) -> None:
    lines = [",".join((*TIP, *PRESSURES[1:]))]
    for k, r in enumerate(ROWS):
        tip = ",".join(f"{v:.3f}" for v in r[4:]) if k % 9 else ",,"
        lines.append(f"{r[0]:.3f},{tip}," + (",".join(f"{v:.3f}" for v in r[1:4]) if k < 900 else ",,"))
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    assert not any("rows of their own" in n for n in read(tmp_path / "a.csv", Source()).notes)
