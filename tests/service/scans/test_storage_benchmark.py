from steradian_benchmarks.storage import storage


def test_the_storage_benchmark_measures_both_and_leaves_an_intact_file(tmp_path):
    rows = storage(folder=tmp_path, quick=True)
    assert [row["batch"] for row in rows] == [8, 32]
    assert all(row["intact"] and row["alines_s"] > 0 and row["plain_s"] > 0 for row in rows)
    assert all(1.0 < row["file_over_raw"] < 1.2 for row in rows)
    assert not list(tmp_path.iterdir())
