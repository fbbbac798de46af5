"""What a lab's own sensors measured is drawn and told with name and unit."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from lab.pages.figures import apart, in_a_row
from lab.pages.sensors_figure import numbers, quantities, sensors
from model.actuators import Chambers
from recordings.trials import Table, TrialRow

pytestmark = pytest.mark.usefixtures("drawn")


def table() -> Table:
    """Six states of a thermometer that feels the pressure; one was read without it."""
    rows = [
        TrialRow(
            trial=1 + i // 3, step=1 + i % 3, protocol="bending", repeat=1, branch="load", t=30.0 * i,
            spine_length=0.1 * (i // 3), pressures=(20e3 * i,) * 3,
            sensors={} if i == 4 else {"sensor_skin_temperature": 296.0 + 0.1 * i, "sensor_skin_humidity": 0.38},
            sd={} if i == 4 else {"sensor_skin_temperature": 0.03, "sensor_skin_humidity": 0.01},
        )
        for i in range(6)
    ]  # fmt: skip
    return Table(tuple(rows), sensor_units={"sensor_skin_temperature": "K", "sensor_skin_humidity": "1"})


def test_names_and_units_are_those_that_were_recorded() -> None:
    assert quantities(table()) == ("sensor_skin_humidity", "sensor_skin_temperature")
    _, (humidity, temperature) = numbers(table())
    assert humidity[0] == "skin_humidity" and temperature[0] == "skin_temperature, K"
    assert temperature[1:] == ("5", "296", "296.22", "296.5", "0.03")


def test_a_table_without_units_has_names_alone() -> None:
    _, rows = numbers(Table(table().rows))
    assert [row[0] for row in rows] == ["skin_humidity", "skin_temperature"]


def test_every_quantity_is_drawn(tmp_path: Path) -> None:
    picture = matplotlib.image.imread(in_a_row(sensors(table(), Chambers.words), tmp_path / "sensors.png"))
    dark = picture[..., :3].min(axis=2) < 0.5
    assert all(np.mean(part) > 0.001 for part in np.array_split(dark, 4))


def test_a_page_has_a_panel_for_each_quantity_and_axis(tmp_path: Path) -> None:
    panels = [matplotlib.image.imread(path) for path in apart(sensors(table(), Chambers.words), tmp_path / "sensors.png")]
    assert len(panels) == 4
    assert all(panel.shape[1] < 700 for panel in panels)  # at 150 dots an inch: no wider than a phone
    assert all((panel[..., :3].min(axis=2) < 0.5).mean() > 0.001 for panel in panels)
