"""``python -m steradian_benchmarks gpu``: its rows, and the sentence where there is no GPU."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from steradian.imaging.engines.cuda import array_backend
from steradian_benchmarks.commands import app
from steradian_benchmarks.gpu import FASTER, LIMIT, gpu, limit_violations
from steradian_benchmarks.gpu_report import BEGIN, END, tables

ROOT = Path(__file__).parents[3]


@pytest.mark.skipif(array_backend.unavailable_reason() is None, reason="there is a GPU")
def test_gpu_benchmark_without_gpu_names_missing_package() -> None:
    result = CliRunner().invoke(app, ["gpu", "--quick"])
    assert result.exit_code != 0
    assert "CuPy" in str(result.exception)
    assert "pip install 'steradian[gpu]'" in str(result.exception)


@pytest.mark.long
def test_it_runs_to_its_end_and_names_the_device(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    if array_backend.unavailable_reason():
        monkeypatch.setenv(array_backend.USE_SIMULATOR, "simulator")
    result = CliRunner().invoke(app, ["gpu", "--quick", "--repeats", "1", "--json", str(tmp_path / "gpu.json")])
    assert result.exit_code == 0, result.output
    rows = {row["case"]: row for row in json.loads((tmp_path / "gpu.json").read_text())["rows"]}
    assert len({row["device"] for row in rows.values()}) == 1
    for name in ("direct 6", "direct, as many anywhere"):
        assert min(rows[name][what] for what in ("gpu_s", "memory_s", "pair_s", "cpu_s", "up_s", "down_s")) > 0
        assert rows[name]["same_bits"]
        assert rows[name]["error"] < 1e-4
        assert rows[name]["difference"] < 1e-4
    for name in ("model", "adjoint", "gradients"):
        assert rows[name]["difference"] < 1e-4
    assert abs(rows["fit"]["fit_correlation"] - rows["fit"]["cpu_correlation"]) < 1e-2
    assert "gpu_s" in rows["cuFINUFFT"] or rows["cuFINUFFT"]["why_not"]
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    result = CliRunner().invoke(app, ["gpu", "--figures", str(tmp_path / "gpu.json"), "--page", str(page)])
    assert result.exit_code == 0, result.output
    text = page.read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "direct, as many anywhere" in text
    assert "A fit of the paper's yarn" in text
    assert "Derivatives of all A-lines" in text
    assert "old" not in text


@pytest.mark.long
def test_script_for_a_machine_with_a_gpu_measures_and_writes_the_page(tmp_path: Path) -> None:
    """In Numba's simulator where there is no GPU, of one case."""
    environment = os.environ | {"OUT": str(tmp_path), "PYTHON": sys.executable, "COLUMNS": "180"}
    if array_backend.unavailable_reason():
        environment |= {"NUMBA_ENABLE_CUDASIM": "1", array_backend.USE_SIMULATOR: "simulator"}
    script = [ROOT / "benchmarks" / "gpu_session.sh", "benchmark", "--quick", "--repeats", "1", "--only", "direct 6"]
    ran = subprocess.run(script, env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "device:" in (tmp_path / "machine.txt").read_text()
    assert json.loads((tmp_path / "gpu.json").read_text())["rows"][0]["same_bits"]
    before, _, after = (tmp_path / "performance.md").read_text(encoding="utf-8").partition(BEGIN)
    assert before == (ROOT / "docs" / "performance.md").read_text(encoding="utf-8").partition(BEGIN)[0]
    assert "| direct 6 |" in after.partition(END)[0]


def test_only_some_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    if array_backend.unavailable_reason():
        monkeypatch.setenv(array_backend.USE_SIMULATOR, "simulator")
    (row,) = gpu(quick=True, repeats=1, only="lateral")
    assert row["gpu_s"] > 0


def test_limit_violations_lists_each_missed_limit() -> None:
    good = {"case": "direct 226", "ratio": LIMIT, "faster": FASTER}
    assert limit_violations([good, {"case": "fit", "fit_s": 0.9, "faster": 3.0}]) == []
    assert limit_violations([good | {"ratio": 3.0, "faster": 4.0}, {"case": "fit", "fit_s": 2.5}]) == [
        "direct 226: 3.00 pairs instead of 1.5",
        "direct 226: 4.0 times faster instead of 15",
        "fit: 2.50 s instead of 1",
    ]


def test_gpu_tables_list_measurements_and_skip_reasons() -> None:
    rows = [
        {"case": "direct 226", "device": "NVIDIA H100", "sensors": 1605, "shape": "226×226×1024", "gpu_s": 0.0031,
         "pair_s": 0.002, "ratio": 1.55, "cpu_s": 0.5, "faster": 161.3, "error": 2.1e-5},
        {"case": "cuFINUFFT", "device": "NVIDIA H100", "peer": "cufinufft 2.4.1", "why_not": "no library"},
    ]  # fmt: skip
    machine = {"cpus": 16, "processor": "Xeon", "python": "3.12.3"}
    text = tables({"machine": machine, "rows": rows, "measured": "2030-01-02T03:04:05+00:00"})
    assert text.startswith("NVIDIA H100; 16 × Xeon, Python 3.12.3, 2030-01-02.")
    assert "| direct 226 | 1,605 | 226×226×1024 | 3.1 |  |  |  | 2 | 500 | 1.55 | 161.3 |  | 2.1e-05 |" in text
    assert "- cufinufft 2.4.1: not measured (no library)." in text
