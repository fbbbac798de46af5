"""The picture of an import: a panel for each group of chambers, and nothing on top of the data."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from test_import_tables import ROBOT
from test_import_trials import ONE_REST, by_map, table

from lab.files.config import load
from lab.pages import import_figure
from model.robot import Robot


@pytest.mark.usefixtures("drawn")
@pytest.mark.parametrize(
    ("groups", "titles"),
    [
        (((2,),), ["p2"]),
        (((1,), (3,), (1, 3), (1, 2, 3)), ["p1", "p3", "p1 + p3", "p1 + p2 + p3"]),
        (((1,), (2,), (3,), (1, 2), (1, 3), (2, 3)), ["p1", "p2", "p3", "p1 + p2", "p1 + p3", "p2 + p3"]),
    ],
)  # fmt: skip
def test_the_picture_has_a_panel_for_each_group_and_legends_beside_the_data(
    groups: tuple[tuple[int, ...], ...], titles: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(import_figure, "save", lambda figure, path: drawn.append(figure))
    made = by_map(tmp_path, table(ONE_REST, lambda *_: (), (), groups=groups), trials={"begin": "rest"})
    import_figure.draw(made, load(ROBOT, Robot), tmp_path / "states.png")
    (figure,) = drawn
    figure.canvas.draw()
    axes = [ax for ax in figure.axes if ax.axison]
    assert [ax.get_title() for ax in axes if ax.get_title().startswith("p")] == titles
    assert all(", " in ax.get_ylabel() for ax in axes)  # a quantity and its unit
    legends = [legend for ax in axes if (legend := ax.get_legend()) is not None]
    assert len(legends) == 2
    for legend, ax in itertools.product(legends, axes):
        assert not legend.get_window_extent().overlaps(ax.get_window_extent()), ax.get_ylabel()
