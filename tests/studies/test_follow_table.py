"""The table of docs/follow.md: a row for each ten minutes, the end, and the most while the forecasts are scored."""

from __future__ import annotations

from benchmarks.follow import SAMPLED, table_of


def test_samples_become_a_row_for_each_ten_minutes_and_one_for_the_scoring(tmp_path):
    times = {30: "", 60: "0 0", 590: "1 2", 600: "3 4", 610: "5 6", 1205: "7 8", 1300: "9 10", 1310: "", 1320: ""}
    lines = [f"{time_s},3,{time_s}.4,200.0,41,1.0,{2 * time_s}.0,{missed}" for time_s, missed in times.items()]
    samples = tmp_path / "samples.csv"
    samples.write_text("\n".join([",".join(SAMPLED), *lines]) + "\n")
    assert table_of(samples).rows == (
        ("1", "60", "200", "41", "120", "0, 0"),
        ("10", "600", "200", "41", "1200", "3, 4"),
        ("20", "1205", "200", "41", "2410", "7, 8"),
        ("22", "1300", "200", "41", "2600", "9, 10"),
        ("scoring, at most", "1320", "200", "41", "2640", ""),
    )
