"""Text tables of other laboratories: proposed map and import give the states of the plain table, or say what is missing."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import refused
from foreign import by_map, pressures, through, tips

from benchmarks.faults.foreign_tables import BARE, HEADINGS, PLATEAUS, STATES, UNITS, Change, comma, sweep, text
from lab.files.config import ConfigError
from lab.files.map_file import Source
from lab.imports.columns import judge, number
from lab.imports.formats import read
from lab.imports.headings import chamber, heading

FEW, MANY = sweep(), sweep(40)
HIDDEN = 4


def words(k: int, cells: list[str], word: str) -> list[str]:
    return cells if k % 7 != 3 else [*cells[:4], *[word] * 3]


def clock(seconds: int) -> str:
    return f"{seconds // 3600 % 24:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


LVM = "LabVIEW Measurement\nWriter_Version\t2\nSeparator\tTab\nDate\t2024/03/01\n***End_of_Header***\n\n"
EPOCH = 1_709_290_000.0
NAMED, KINDS_OF = "Time,P1,P2,P3,Tip X,Tip Y,Tip Z", "s,kPa,kPa,kPa,mm,mm,mm"
DEVICES = "clock,SN11,SN12,SN13,cam A,cam B,cam C"
ALIKE = "Logger,Regulator,Regulator,Regulator,Camera,Camera,Camera"
HEADS = {
    "groups above numbers": ["Time,Pressure,,,Tip,,", "s,1,2,3,X,Y,Z"],
    "groups with units above numbers": ["Time,Pressure [kPa],,,Tip [mm],,", ",1,2,3,X,Y,Z"],
    "repeated names above numbers": ["t [s],Druck [kPa],Druck [kPa],Druck [kPa],Ort [mm],Ort [mm],Ort [mm]", ",1,2,3,x,y,z"],
    "names, units, devices": [NAMED, KINDS_OF, DEVICES],
    "names, devices, units": [NAMED, DEVICES, KINDS_OF],
    "devices, names, units": [DEVICES, NAMED, KINDS_OF],
    "names, devices alike, units": [NAMED, ALIKE, KINDS_OF],
    "rig, devices, names, units": ["Rig A,,,,Rig A,,", "Logger,Regulator,,,Camera,,", NAMED, KINDS_OF],
    "quantity, which one, unit": [
        "Time,Pressure,Pressure,Pressure,Tip,Tip,Tip", ",ch 1,ch 2,ch 3,X,Y,Z", "[s],[kPa],[kPa],[kPa],[mm],[mm],[mm]",
    ],
    "a station above, a process below": ['"TOA5","stn","CR1000","1","2","3","4"', NAMED, KINDS_OF, ",Smp,Smp,Smp,Avg,Avg,Avg"],
    "channels above": ["Channel,101,102,103,201,202,203", NAMED, KINDS_OF],
    "channels below": [NAMED, KINDS_OF, "Channel,101,102,103,201,202,203"],
    "numbers above": ["0,101,102,103,201,202,203", NAMED, KINDS_OF],
    "ranges below": [NAMED, KINDS_OF, "-,0..100,0..100,0..100,-200..200,-200..200,-200..200"],
}  # fmt: skip
PLAIN = {
    "plain": text(FEW),
    "Windows line ends": text(FEW, end="\r\n"),
    "old line ends": text(FEW, end="\r"),
    "units below, in brackets": text(FEW, headings=BARE).replace("\n", "\n" + ",".join(f"[{u}]" for u in UNITS) + "\n", 1),
    "units below, semicolons": text(FEW, ";", BARE).replace("\n", "\nSekunden;kPa;kPa;kPa;mm;mm;mm\n", 1),
    "units above": ",".join(UNITS) + "\n" + text(FEW, headings=BARE),
    "units and comments below": text(FEW, "\t", BARE).replace("\n", "\n" + "\t".join(UNITS) + "\nrun 3\t\t\t\t\t\t\n", 1),
    "units in the preamble": "# pressures in kPa, positions in mm, time in s\n" + text(FEW, headings=BARE),
    "units listed in the preamble": "Units: " + "; ".join(UNITS) + "\n" + text(FEW, ";", BARE),
    "units after commas": text(FEW, ";", [h.replace(" [", ", ").rstrip("]") for h in HEADINGS]),
    "unit in every cell": text(FEW, ";", BARE, lambda k, c: [f"{v} {u}" for v, u in zip(c, UNITS, strict=True)]),
    "decimal comma in pressures": text(FEW, ";", change=lambda k, c: comma(c, 1, 2, 3)),
    "decimal comma in quotation marks": text(FEW, ",", change=lambda k, c: [f'"{v}"' for v in comma(c, 0, 4, 5, 6)]),
    "tabs, decimal comma in the time": text(FEW, "\t", change=lambda k, c: comma(c, 0)),
    "thousands": text(FEW, ";", ["Time [ms]", *HEADINGS[1:]], lambda k, c: [f"{1e3 * float(c[0]):,.1f}", *c[1:]]),
    "spaces": text(FEW, "   ", BARE).replace("Time   ", "  Time   ").replace("Tip ", "Tip_"),
    "spaces, units in headings": text(FEW, "  "),
    "comments before and among": "# robot B\n% second line\n" + text(FEW).replace("\n8.000", "\n# valve clicked\n8.000"),
    "commented headings": "# " + text(FEW, "\t"),
    "trailing separators and a footer": text(FEW, ";", [*HEADINGS, "", ""], lambda k, c: [*c, "", ""]) + "\nEnd of measurement\n",
    "a footer of means": text(FEW) + "Mean,10.0,10.0,10.0,0.0,0.0,145.0\nSD,1,1,1,1,1,1\n",
    "headings again in the middle": text(FEW[:15]) + text(FEW[15:]),
    "empty lines": text(FEW).replace("\n", "\n\n"),
    "sep=": "sep=;\n" + text(FEW, ";"),
    "LabVIEW": LVM + text(FEW, "\t", [*HEADINGS, "Comment"]),
    "preamble padded with separators": "Operator,Anna,,,,,\nRate,100,,,,,\n,,,,,,\n" + text(FEW),
    "an empty column in front": text(FEW, headings=["", *HEADINGS], change=lambda k, c: ["", *c]),
    "a column of words in front": text(FEW, headings=["Label", *HEADINGS], change=lambda k, c: [f"run {k % 3}", *c]),
    "UTF-8 with a mark": b"\xef\xbb\xbf" + text(FEW).encode(),
    "UTF-16": text(FEW, "\t").encode("utf-16"),
    "UTF-16 without a mark": text(FEW, "\t").encode("utf-16-le"),
    "Windows code page": ("Gerät: µ-Regler\n" + text(FEW, ";")).encode("cp1252"),
    "a logger that lost its power": text(FEW).encode() + b"\0" * 300,
    "break in a heading": text(FEW, headings=['"Time\n[s]"', *HEADINGS[1:]]),
    "Cyrillic": text(FEW, headings=["Время [с]", *(f"P{k} [кПа]" for k in (1, 2, 3)), *(f"{a} [мм]" for a in "XYZ")]),
    "Shift JIS": text(FEW, headings=["時間[s]", *(f"圧力{k}[kPa]" for k in (1, 2, 3)), *HEADINGS[4:]]).encode("shift_jis"),
    "minus signs and signs": text(FEW, ";", change=lambda k, c: [*c[:4], *[v.replace("-", "\u2212") for v in c[4:]]]),
    "dashes as minus signs": text(FEW, ";", change=lambda k, c: [v.replace("-", "\u2013") for v in c]),
    "exponents of Fortran": text(FEW, ";", change=lambda k, c: [f"{float(v):.6E}".replace("E", "D") for v in c]),
    **{
        f"epoch in {unit}": text(
            FEW, headings=["timestamp", *HEADINGS[1:]], change=lambda k, c, f=factor: [f"{(EPOCH + 4.0 * k) * f:.0f}", *c[1:]]
        )
        for unit, factor in (("s", 1), ("ms", 1e3), ("us", 1e6), ("ns", 1e9))
    },
    **{
        f"days of {whose}": text(
            FEW, headings=["Time", *HEADINGS[1:]], change=lambda k, c, d=day: [f"{d + 4.0 * k / 86_400:.9f}", *c[1:]]
        )
        for whose, day in (("a spreadsheet", 45_244.9), ("MATLAB", 739_204.9))
    },
    "technical atmospheres": text(
        FEW, headings=[h.replace("kPa", "kgf/cm2") for h in HEADINGS],
        change=lambda k, c: [c[0], *(f"{float(p) / 98.0665:.6f}" for p in c[1:4]), *c[4:]],
    ),
    "a unit of its own for each column": text(
        FEW, headings=["Time [s]", "P1 [bar]", *HEADINGS[2:6], "Tip Z (in)"],
        change=lambda k, c: [c[0], f"{float(c[1]) / 100:.5f}", *c[2:6], f"{float(c[6]) / 25.4:.6f}"],
    ),
    "dates": text(FEW, change=lambda k, c: [f"2024-03-01 12:{4 * k // 60:02d}:{4 * k % 60:02d}.250", *c[1:]]),
    "times of day over midnight": text(FEW, change=lambda k, c: [clock(86_350 + 4 * k), *c[1:]]),
    **{f"a heading of {lines}": "\n".join([*head, text(FEW).partition("\n")[2]]) for lines, head in HEADS.items()},
}  # fmt: skip


@pytest.mark.parametrize("kind", PLAIN)
def test_a_table_gives_the_states_of_the_plain_one(kind: str, tmp_path: Path) -> None:
    _, made = through(tmp_path / "table.csv", PLAIN[kind])
    assert len(made.table) == STATES, made.notes
    wanted = np.array(FEW)
    assert tips(made.table) == pytest.approx(wanted[:, 4:], abs=2e-3)
    assert pressures(made.table) == pytest.approx(wanted[:, 1:4], abs=2e-3)
    assert made.table["t"] - made.table["t"][0] == pytest.approx(wanted[:, 0], abs=1e-3)


@pytest.mark.parametrize(
    ("page", "names"),
    [
        ("cp932", ["時間 [s]", "ポンプ圧力 [kPa]", "先端X [mm]"]),
        ("cp949", ["시간 [s]", "압력 [kPa]", "길이 [mm]"]),
        ("cp1251", ["Время [с]", "Давление [кПа]", "Длина [мм]"]),
        ("cp1252", ["Größe [s]", "Länge [µm]", "Winkel [°]"]),
    ],
)
def test_headings_are_read_in_the_code_page_of_their_language(page: str, names: list[str], tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(text([row[:3] for row in FEW], ";", names).encode(page))
    assert list(read(path, Source()).columns) == names


MISSING = (
    "NA", "NaN", "-", "n/a", "#DIV/0!", "", "null", "--", "1.#QNAN", "-9999", "lost", "Inf", "?", "N.A.", "verdeckt", "-nan(ind)",
    "1.#INF", "\\N", "1e300",
)  # fmt: skip


@pytest.mark.parametrize("word", MISSING)
def test_what_is_missing_is_no_state(word: str, tmp_path: Path) -> None:
    _, made = through(tmp_path / "table.csv", text(FEW, ";", change=lambda k, c: words(k, c, word)))
    assert made.table.with_tip.sum() == STATES - HIDDEN
    assert any(("1e+300: taken as missing" if word == "1e300" else "4 of 30 rows have no ") in n for n in made.notes)
    assert np.nanmax(np.abs(made.table["z"] - 0.14)) < 0.011


def test_words_that_nobody_knows_are_asked_about_and_can_be_declared(tmp_path: Path) -> None:
    made, result = through(tmp_path / "table.csv", text(FEW, ";", change=lambda k, c: words(k, c, "OOR")))
    assert made.values["source"]["missing"] == ["OOR"] and any("'OOR'" in d for d in made.doubts)
    assert result.table.with_tip.sum() == STATES - HIDDEN
    place = tmp_path / "map.yaml"
    place.write_text(place.read_text().replace("missing: [OOR]", "missing: []"))
    refused(r"table.csv, line 5, column 'Tip X \[mm\]' \(columns.x\): 'OOR' .*missing: \['OOR'\]", by_map, tmp_path / "table.csv")


@pytest.mark.parametrize("columns", [slice(4, 7), slice(1, 4)])
def test_missing_rows_neither_end_nor_begin_a_plateau(columns: slice, tmp_path: Path) -> None:
    def change(k: int, cells: list[str]) -> list[str]:
        if (k // 3) % 9 == 2:
            cells[columns] = ["", "NaN", ""]
        return cells

    _, made = through(tmp_path / "table.csv", text(MANY, change=change))
    assert len(made.table) == PLATEAUS
    assert max(made.table["p1"]) == pytest.approx(35e3, abs=30) and min(made.table["p1"]) > -30
    assert np.abs(made.table["z"] - 0.14).max() < 0.011 and made.table["hold"].max() < 4


def test_zeros_among_positions_are_missing_and_reported(tmp_path: Path) -> None:
    zeros = text(MANY, change=lambda k, c: [*c[:4], "0", "0.0", "-0"] if (k // 5) % 8 == 3 else c)
    _, made = through(tmp_path / "table.csv", zeros)
    assert len(made.table) == PLATEAUS and np.abs(made.table["z"] - 0.14).max() < 0.011
    assert any("is exactly 0, 0, 0 in 150 of 1200 rows (first in line 17): taken as missing" in n for n in made.notes)


def test_zeros_are_missing_where_a_place_of_the_base_is_subtracted(tmp_path: Path) -> None:
    guess, whole = through(tmp_path / "table.csv", text(FEW, change=lambda k, c: [*c[:4], "0", "0", "0"] if k == 3 else c))
    columns = guess.values["columns"]
    moved = {axis: columns[axis] | {"zero": 5.0} for axis in "xyz"}
    made = by_map(tmp_path / "table.csv", **guess.values | {"columns": columns | moved})
    assert made.table.with_tip.sum() == whole.table.with_tip.sum() == STATES - 1
    assert any("exactly 0, 0, 0 in 1 of" in n for n in made.notes)


TITLES = {"of its own": "Versuch 1 - Kragarm,,,,Bearbeiter: T. Brandl,,,,,", "of two words": "Run 3,,Load case,,,,,,,"}


@pytest.mark.parametrize("title", TITLES)
def test_a_title_names_no_column_and_time_repeat_and_load_go_by_their_words(title: str, tmp_path: Path) -> None:
    names = "Nr,Laufzeit (s),Durchgang,Anhängelast (kg),P1 (kPa),P2 (kPa),P3 (kPa),Kugel X (mm),Kugel Y (mm),Kugel Z (mm)"
    rows = [f"{k},{r[0]},{1 + 2 * k // len(FEW)},0.05,{','.join(map(str, r[1:]))}" for k, r in enumerate(FEW)]
    guess, made = through(tmp_path / "table.csv", "\n".join([TITLES[title], names, *rows]))
    named = {name: column["column"] for name, column in guess.values["columns"].items()}
    assert (named["t"], named["repeat"], named["tip_mass"]) == ("Laufzeit (s)", "Durchgang", "Anhängelast (kg)")
    assert named["x"] == "Kugel X (mm)" and len(made.table) == STATES


def test_a_unit_that_the_file_contradicts_is_the_first_note_with_its_factor(tmp_path: Path) -> None:
    guess, _ = through(tmp_path / "table.csv", text(FEW))
    pressure = guess.values["columns"]["p1"]
    made = by_map(
        tmp_path / "table.csv", **guess.values | {"columns": guess.values["columns"] | {"p1": pressure | {"unit": "Pa"}}}
    )
    assert "the file says kPa, the map Pa, which is taken and 0.001 times as large" in made.notes[0]


def test_a_displacement_that_is_zero_at_rest_is_a_position(tmp_path: Path) -> None:
    rest = FEW[0][4:]
    rows = [[*r[:4], *(v - w for v, w in zip(r[4:], rest, strict=True))] for r in FEW]
    rows = [[*r[:4], 0.0, 0.0, 0.0] if max(r[1:4]) < 1 else r for r in rows]
    _, made = through(tmp_path / "table.csv", text(rows))
    assert len(made.table) == STATES and not any("missing" in n for n in made.notes)


def test_headings_and_units_are_where_the_map_says(tmp_path: Path) -> None:
    content = "1;2;3\n" + ";".join(BARE) + "\nfree words\n" + ";".join(UNITS) + "\n" + text(FEW, ";", ())
    (tmp_path / "table.csv").write_text(content)
    series = read(tmp_path / "table.csv", Source(heading=2, units=4))
    assert series.names == BARE and [series.units[n] for n in BARE] == list(UNITS) and len(series) == STATES
    with pytest.raises(ConfigError, match="no line below line 400 holds numbers; correct source.units"):
        read(tmp_path / "table.csv", Source(heading=2, units=400))


def test_columns_are_numbered_as_the_file_has_them(tmp_path: Path) -> None:
    for first in ("0.5", "run A", ""):
        (tmp_path / "t.csv").write_text("first,,PA,X\n" + "".join(f"{first},,{p},{x}\n" for p, x in ((1, 5), (2, 6))))
        series = read(tmp_path / "t.csv", Source())
        assert series.columns[series.names[2]].tolist() == [1, 2] and series.columns[series.names[3]].tolist() == [5, 6]


@pytest.mark.parametrize(("cut", "left"), [(0, 0), (1, 0), (2, 1), (5, 1), (9, 1)])
def test_a_last_line_that_was_cut_off_is_left_out(cut: int, left: int, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    written = text(FEW, change=lambda k, c: [*c[:-1], f"{float(c[-1]):.3f}"])
    path.write_text(written[: len(written) - cut])
    found = read(path, Source())
    assert len(found.columns["Time [s]"]) == len(FEW) - left
    assert len(found.notes) == left


def test_a_line_with_too_many_cells_is_left_out_and_many_are_refused(tmp_path: Path) -> None:
    _, made = through(tmp_path / "table.csv", text(FEW).replace("\n8.000,", "\n8,000,"))
    assert len(made.table) == STATES - 1
    assert any("line 4 has more than 7 cells and is skipped: '8,000," in n for n in made.notes)
    commas = text(FEW, change=lambda k, c: comma(c, *range(7)))
    refused("line 1: 7 headings for 14 columns: commas seem to be both", through, tmp_path / "table.csv", commas)


@pytest.mark.parametrize(
    ("cells", "found"),
    [
        (["1,5", "2", "3,25"], [1.5, 2, 3.25]), (["1.234,5", "1.000", "7"], [1234.5, 1000, 7]), (["1 234,5", "2,0"], [1234.5, 2]),
        (["1,234.5", "2", "x"], [1234.5, 2, None]), (["12,5", "12.5"], [12.5, 12.5]), (["1,234", "999.5"], [1234, 999.5]),
        (["1,234", "2,345"], [1.234, 2.345]), (["0020-02-15", "0020-02-16"], ["0020-02-15", "0020-02-16"]),
    ],
)  # fmt: skip
def test_each_column_has_its_own_decimal_mark_and_dates_of_old_are_words(cells: list[str], found: list[object]) -> None:
    import pandas as pd  # slow to import

    assert [None if v != v else v for v in judge(pd.Series(cells, dtype=str)).values.tolist()] == found
    assert number("1e400") is None and number("1_000") is None


def test_each_cell_of_a_table_is_parsed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pandas as pd  # slow to import

    (tmp_path / "table.csv").write_text(text(FEW))
    parsed, to_numeric = [], pd.to_numeric

    def counted(cells: "pd.Series[str]", **how: str) -> object:
        parsed.append(len(cells))
        return to_numeric(cells, **how)

    monkeypatch.setattr(pd, "to_numeric", counted)
    series = read(tmp_path / "table.csv", Source())
    assert len(series) == STATES and sum(parsed) == (1 + STATES) * len(series.names)


def test_marks_between_thousands_are_told_from_decimal_marks_and_noted(tmp_path: Path) -> None:
    def pascal(mark: str) -> Change:
        return lambda k, c: [c[0], *(f"{round(float(v) * 1e3):,}".replace(",", mark) for v in c[1:4]), *c[4:]]

    names = ["t [s]", "P1 [Pa]", "P2 [Pa]", "P3 [Pa]", "X [mm]", "Y [mm]", "Z [mm]"]
    for mark in (",", ".", "'"):
        german = mark == "."
        change = (lambda k, c: comma(pascal(".")(k, c), 0, 4, 5, 6)) if german else pascal(mark)
        _, made = through(tmp_path / "table.csv", text(FEW, ";", names, change))
        assert pressures(made.table) == pytest.approx(np.array(FEW)[:, 1:4], abs=2e-3)
        assert any("is read as 35" in n or "is read as 15" in n or "is read as 14" in n for n in made.notes) == (mark in ",.")


@pytest.mark.parametrize(
    "below",
    [
        [*HEADINGS[:4], "Tip Y [mm]", "Tip X [mm]", "Tip Z [mm]"],
        ["Time [s]", "P1 [bar]", "P2 [bar]", "P3 [bar]", *HEADINGS[4:]],
        ["s", "bar", "bar", "bar", "mm", "mm", "mm"],
    ],
)
def test_a_table_below_another_is_refused(below: list[str], tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"table.csv, line 17: says '.*' and begins another table than line 2"):
        through(tmp_path / "table.csv", text(FEW[:15]) + text(FEW[15:], headings=below))


def test_labview_s_headers_hold_no_readings(tmp_path: Path) -> None:
    about = "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\n***End_of_Header***\t\n\t\n"
    segment = "Channels\t6\t\t\t\t\t\t\t\n"
    for key, one in (("Samples", "15"), ("Date", "2024/03/01"), ("Time", "14:05:12,1"), ("X0", "0,0E+0"), ("Delta_X", "4,0")):
        segment += "\t".join([key, *[one] * 6, "", ""]) + "\n"
    segment += "\t".join(["Y_Unit_Label", *UNITS[1:], "", ""]) + "\n***End_of_Header***\t\t\t\t\t\t\t\n"
    segment += "\t".join(["X_Value", *BARE[1:], "Comment"]) + "\n"
    parts = [text(rows, "\t", (), lambda k, c: comma(c, *range(7))) for rows in (FEW[:15], FEW[15:])]
    made, result = through(tmp_path / "table.lvm", about + "".join(segment + part for part in parts))
    assert made.values["columns"]["t"] == {"column": "X_Value"} and len(result.table) == STATES
    assert result.table["p1"] / 1e3 == pytest.approx([r[1] for r in FEW], abs=2e-3)


@pytest.mark.parametrize(("step", "unit"), [(40, "ms"), (40_000, "us"), (40_000_000, "ns")])
def test_the_unit_of_times_follows_from_their_steps_and_is_asked_about(step: int, unit: str, tmp_path: Path) -> None:
    content = text(MANY, headings=["time", *HEADINGS[1:]], change=lambda k, c: [str(step * k), *c[1:]])
    made, result = through(tmp_path / "table.csv", content)
    assert made.values["columns"]["t"]["unit"] == unit and any("columns.t" in d for d in made.doubts)
    assert len(result.table) == PLATEAUS


def test_the_units_of_trials_csv_are_known(tmp_path: Path) -> None:
    own = ["t", "p1", "p2", "p3", "x", "y", "z", "trial", "step", "protocol", "repeat", "branch", "spine_length"]
    cells = ["1", "0", "bending", "1", "load", "0"]
    table = tmp_path / "table.csv"
    table.write_text(text(MANY, headings=own, change=lambda k, c: [str(40 * k), *c[1:7], *cells]))
    series = read(table, Source())
    units = {"t": ["ms", "s"], "p1": ["kPa", "Pa"], "x": ["mm", "m"]}
    assert [series.unit_of(c, known) for c, known in units.items()] == ["s", "Pa", "m"]


def test_a_count_of_frames_with_gaps_tells_the_times(tmp_path: Path) -> None:
    lines = text(MANY, headings=["Frame", *HEADINGS[1:]], change=lambda k, c: [str(3 * k), *c[1:]]).splitlines()
    kept = [line for k, line in enumerate(lines) if k % 40 < 16 or k % 3]
    made, result = through(tmp_path / "table.csv", "\n".join(kept) + "\n")
    assert made.values["columns"]["t"] == {"column": "Frame", "scale": 0.01} and any("0.01 s per frame" in d for d in made.doubts)
    assert len(result.table) == PLATEAUS


@pytest.mark.parametrize("time", [lambda k: f"{k // 25}", lambda k: f"{k // 10 * 0.4 + k % 10 * 1e-3:.3f}"],
                         ids=["of whole seconds", "of bursts"])  # fmt: skip
def test_times_need_not_be_evenly_spaced(time: Callable[[int], str], tmp_path: Path) -> None:
    _, result = through(tmp_path / "table.csv", text(MANY, change=lambda k, c: [time(k), *c[1:]]))
    assert len(result.table) == PLATEAUS


@pytest.mark.parametrize(
    ("name", "number_of"),
    [
        ("Temp1 [°C]", None), ("Step1", None), ("Supply pressure 1 (bar)", None), ("Flow P1 [l/min]", None), ("pSet2", 2),
        ("p[1]", 1), ("P3 (mmHg)", 3), ("Regulator 2 [kPa]", 2), ("Druck2_Soll", 2),
        ("/regulators/measured.layout.data_offset", None), ("/regulators/measured.data.2", 2),
    ],
)  # fmt: skip
def test_headings_of_chambers(name: str, number_of: int | None) -> None:
    assert chamber(heading(name)) == number_of


def test_columns_that_share_numbers_keep_the_file_s_order_which_is_asked_about(tmp_path: Path) -> None:
    names = ["L1 [kPa]", "L2 [kPa]", "S1 [kPa]"]
    made, _ = through(tmp_path / "table.csv", text(FEW, headings=[HEADINGS[0], *names, *HEADINGS[4:]]))
    assert [made.values["columns"][f"p{k}"]["column"] for k in (1, 2, 3)] == names
    assert any(d.startswith("columns.p1: L1 [kPa], L2 [kPa], S1 [kPa] share numbers") for d in made.doubts)


# ------------------------------------------------------------------ angles
@pytest.mark.parametrize(
    "names",
    [("Roll", "Pitch", "Yaw"), ("Tip Rx (deg)", "Tip Ry (deg)", "Tip Rz (deg)"), ("Rollen", "Nicken", "Gieren"),
     ("Rx [rad]", "Ry [rad]", "Rz [rad]")],
)  # fmt: skip
def test_three_angles_are_the_tip_s_orientation(names: tuple[str, ...], tmp_path: Path) -> None:
    unit, order = "rad" if "rad" in names[0] else "deg", "rotation vector"

    def change(k: int, cells: list[str]) -> list[str]:
        chamber, level = k // 5 % 3, FEW[k][1 + k // 5 % 3]
        turn = 0.013 * level if unit == "rad" else np.degrees(0.013 * level)
        azimuth = np.radians(120 * chamber)
        return [*cells, f"{turn * np.sin(azimuth):.4f}", f"{-turn * np.cos(azimuth):.4f}", "0.0"]

    made, result = through(tmp_path / "table.csv", text(FEW, headings=[*HEADINGS, *names], change=change))
    assert made.values["orientation"] == {"columns": list(names), "order": order, "unit": unit}
    assert any("orientation" in d and "order" in d for d in made.doubts) and "roll_deg" not in made.values["columns"]
    assert {r.roll_deg for r in result.table} == {None} and result.table.rows[2].orientation is not None


def test_a_turn_of_the_mount_does_not_change_within_a_trial(tmp_path: Path) -> None:
    content = text(FEW, headings=[*HEADINGS, "Roll"], change=lambda k, c: [*c, str(90 + 3 * (k % 5))])
    made, _ = through(tmp_path / "table.csv", content)
    assert "roll_deg" not in made.values["columns"] and any("'Roll' changes from row to row" in d for d in made.doubts)
    values = yaml.safe_load((tmp_path / "map.yaml").read_text())
    values["columns"]["roll_deg"] = {"column": "Roll"}
    with pytest.raises(ConfigError, match=r"columns.roll_deg: from 90 to 102 deg within trial 1, .* write it under orientation"):
        by_map(tmp_path / "table.csv", **values)
