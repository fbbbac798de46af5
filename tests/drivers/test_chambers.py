"""The wiring between channels and chambers."""

import pytest

from drivers.chambers import PAPER_WIRING, ChamberMap

NINE = [[i] for i in range(1, 10)]


def test_a_set_of_three_is_made_by_its_channel_alone() -> None:
    assert ChamberMap(PAPER_WIRING).setpoints({9: 5e4, 1: 5e4, 2: 5e4}) == (5e4, 0.0, 0.0)


def test_nine_separate_channels_make_any_pattern() -> None:
    pattern = {i: 1e3 * i for i in range(1, 10)}
    assert ChamberMap(NINE).setpoints(pattern) == tuple(1e3 * i for i in range(1, 10))


ONE_OF_NINE = ChamberMap([[1], [2]], 9)


@pytest.mark.parametrize(
    ("wiring", "wanted", "message"),
    [
        (ChamberMap(PAPER_WIRING), {9: 1e4, 1: 1e4, 2: 2e4},
         r"channel 1 feeds chambers 9, 1, 2 .* chamber 1: 10000 Pa, chamber 2: 20000 Pa"),
        # a chamber left out counts as zero, so it cannot follow its neighbours unasked
        (ChamberMap(PAPER_WIRING), {9: 1e4, 1: 1e4}, "chamber 2: 0 Pa"),
        (ONE_OF_NINE, {7: 1e4}, "chamber 7 is not connected.*connected are 1, 2"),
        (ChamberMap([[1], [2], [3]], 3), {4: 1e4}, "4 is not a chamber; chambers are numbered 1 to 3"),
    ],
)  # fmt: skip
def test_pressures_that_the_wiring_cannot_make_are_refused(wiring: ChamberMap, wanted: dict[int, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        wiring.setpoints(wanted)


def test_a_chamber_that_is_not_connected_may_stay_flat() -> None:
    assert ONE_OF_NINE.setpoints({1: 1e4, 7: 0.0}) == (1e4, 0.0)


def test_channel_values_are_spread_over_the_chambers_and_unconnected_ones_read_zero() -> None:
    assert ChamberMap([[9, 1], [4]]).by_chamber((7.0, 3.0)) == (7.0, 0, 0, 3.0, 0, 0, 0, 0, 7.0)


def test_a_wrong_number_of_channel_values_is_refused() -> None:
    with pytest.raises(ValueError, match="2 values for 3 channels"):
        ChamberMap(PAPER_WIRING).by_chamber((1.0, 2.0))


@pytest.mark.parametrize(
    ("chambers", "message"),
    [
        ([[1, 2], [2, 3]], "chamber 2 is listed for channel 1 and for channel 2"),
        ([[1, 1]], "chamber 1 is listed for channel 1 and for channel 1"),
        ([[0]], "0 is not a chamber"),
        ([[10]], "10 is not a chamber"),
        ([[1], []], "channel 2 feeds no chamber"),
    ],
)
def test_a_wiring_that_cannot_be_is_refused(chambers: list[list[int]], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ChamberMap(chambers, 9)


def test_a_robot_has_as_many_chambers_as_it_has() -> None:
    assert ChamberMap([[1], [2], [3]], 3).by_chamber((1.0, 2.0, 3.0)) == (1.0, 2.0, 3.0)
    assert ChamberMap([], 9).by_chamber(()) == (0.0,) * 9
