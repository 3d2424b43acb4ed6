"""``steradian benchmark load`` in small: every kind of client is served, and the page holds what was measured."""

import asyncio
import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import linregress

from steradian.benchmarks.load import load
from steradian.benchmarks.load_report import BEGIN, END, write_page
from steradian.benchmarks.mixed_load import WEIGHTS
from steradian.benchmarks.service import running_service
from steradian.benchmarks.service_memory import MemorySampler, _growth
from steradian.core.settings import Settings


@pytest.mark.long
def test_a_benchmark_finds_the_service_that_it_starts(tmp_path):
    with running_service(Settings.create(data=tmp_path, port=0, workers=0)) as service:
        assert service.request("/masks") == {"items": []}


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_nothing_is_lost_under_a_small_load(tmp_path):
    rows = load(seconds=10, clients=10, streams=3)
    kinds = {
        kind: [row for row in rows if row["case"] == kind] for kind in ("route", "total", "memory", "reads", "rude")
    }
    (total,) = kinds["total"]
    assert {row["process"] for row in kinds["memory"]} > {"api", "acquisition", "worker", "simulator", "supervisor"}
    assert (total["server_errors"], total["alines_lost"], total["scan"]) == (0, 0, "complete")
    assert total["events"] > 0
    assert (total["events_lost"], total["events_again"]) == (0, 0)
    assert total["jobs_succeeded"] > 0
    assert {row["route"] for row in kinds["route"]} > set(WEIGHTS)
    met = {row["clients"]: row["met_with"] for row in kinds["rude"]}
    for what in ("headers", "bodies"):
        assert met[f"300 half-sent {what}"] == {"closed": 300, "kept": 0}
    for what in ("of positions", "where a few bytes belong"):
        assert met[f"60 MiB {what}"] == {"413": 2}, "the refusal can be read"
    page = tmp_path / "load.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    write_page(page, rows)
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    assert all(f"| {row['clients']} |" in text for row in kinds["rude"])


def test_growth_is_that_of_a_line_of_least_squares_after_the_first_quarter():
    """SciPy's slope and its standard error; what caches take at first does not count."""
    seconds = np.arange(400.0)
    mib = 200 + 0.05 * seconds + np.random.default_rng(0).normal(0, 2, 400)
    mib[:100] -= 150
    told = _growth(list(zip(seconds, mib, strict=True)))
    line = linregress(seconds[100:] / 60, mib[100:])
    assert (told["mib_per_minute"], told["error"]) == (pytest.approx(line.slope), pytest.approx(line.stderr))
    assert told["mib_per_minute"] == pytest.approx(3, abs=4 * told["error"])
    assert (told["first_mib"], told["last_mib"], told["most_mib"]) == (mib[0], mib[-1], mib.max())


@pytest.mark.long
def test_memory_watch_reports_growth_per_process(tmp_path):
    """One that takes 4 MiB again and again grows, the one above it, which waits for it, hardly does.

    It may shrink: systems take pages from whoever does not use them.
    """
    grow, start = tmp_path / "steradian.api.py", tmp_path / "start.py"
    grow.write_text(
        "import time\nheld = []\nwhile len(held) < 60:\n    held.append(bytearray(b'1' * 2**22)); time.sleep(0.05)\n"
    )
    start.write_text(f"import subprocess, sys\nsubprocess.run([sys.executable, {str(grow)!r}])\n")
    process = subprocess.Popen([sys.executable, str(start)])
    watch, over = MemorySampler(process.pid, 0.05), asyncio.Event()

    async def follow():
        watching = asyncio.create_task(watch.watch(over))
        await asyncio.to_thread(process.wait)
        over.set()
        await watching

    asyncio.run(follow())
    found = {row["process"]: row for row in watch.rows()}
    assert found["api"]["most_mib"] > 200
    assert found["supervisor"]["mib_per_minute"] < 0.1 * found["api"]["mib_per_minute"]
    assert len(found["api"]["over_time"]) > 10


def test_memory_watch_excludes_child_process_from_api_memory(tmp_path):
    """Its process holds little, the one that it starts and that ends again 64 MiB."""
    (tmp_path / "steradian.api.py").write_text(
        "import subprocess, sys\n"
        "command = [sys.executable, sys.argv[0].replace('.py', '.background.process_pool.py')]\n"
        "child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)\n"
        "child.stdout.readline(); print('held', flush=True); sys.stdin.readline()\n"
        "child.communicate(); print('free', flush=True); sys.stdin.readline()\n"
    )
    (tmp_path / "steradian.api.background.process_pool.py").write_text(
        "import sys\nheld = b'1' * 2**26\nprint(flush=True)\nsys.stdin.read()\n"
    )
    command = [sys.executable, str(tmp_path / "steradian.api.py")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        watch = MemorySampler(process.pid, 1.0)
        for said in ("held", "free"):
            assert process.stdout.readline().strip() == said
            watch.sample()
            process.stdin.write("\n")
            process.stdin.flush()
    found = {row["process"]: row for row in watch.rows()}
    assert found["api"]["most_mib"] < 60
    assert (found["api's process pool"]["most_mib"] > 64, found["api's workshop"]["last_mib"]) == (True, 0)
