"""Small figures reach from zero to the highest score, or to the end that is asked for, and draw confidence bands."""

from gridtrack.reports.figures import Series
from gridtrack.reports.sweeps import series_of, sweep_panel

ONE, OTHER = Series("a", "a", "t0"), Series("b", "b", "t1")


def test_a_panel_reaches_from_zero_to_the_highest_score():
    panel = sweep_panel("F1", "dynamic", [(0.0, "0"), (2.0, "2")], [(ONE, (0.24, None)), (OTHER, (0.1, 0.3))])
    assert [words for _, words in panel.y_ticks] == ["0", "0.15", "0.3"]
    only, both = panel.lines
    assert len(only.points) == 1
    assert both.points[1] == (panel.x.end, panel.y_ticks[2][0])
    assert panel.words == "F1, dynamic: a from 0.240 to undefined, b from 0.100 to 0.300"
    assert series_of([panel, panel]) == (ONE, OTHER)


def test_a_band_goes_along_its_low_ends_and_back_along_its_high_ends():
    ticks, band = [(1.0, "1"), (3.0, "3")], ((0.2, 0.4), (0.3, 0.5))
    panel = sweep_panel("FSS", "dynamic", ticks, [(ONE, (0.25, 0.45)), (OTHER, (0.1, 0.3))], [band, None], top=1.0)
    corners = [tuple(map(float, corner.split(","))) for corner in panel.lines[0].band.split()]
    left, right = panel.x.start, panel.x.end
    assert [x for x, _ in corners] == [left, right, right, left]
    heights = [y for _, y in corners]
    assert heights[1] < heights[0]
    assert heights[3] < heights[0], "up is better"
    assert panel.lines[1].band == ""
