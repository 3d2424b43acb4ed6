"""What holds for a whole run: the order of the files, and that started programs keep their bytecode."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

from support.budget import Budget

WEB, MEASURED = (Path(__file__).with_name(name) for name in ("web", "measured"))
MEASURED_DATA = "STERADIAN_MEASURED_DATA"
"""Variable of the environment that names the folder of measured data."""
LONGEST = """
    docs/test_first_hour test_hardware_page test_mutants test_backup test_contributing test_attacking_files
    runtime/test_work api/test_expensive scans/test_import_guarded jobs/test_queue drawing/test_labels
    api/test_quota cli/test_commands api/test_deletion cli/test_terminal imaging/test_accuracy
    driver/test_driver_command api/test_together api/test_races test_serve test_emergency_stop
    clients/test_python_client clients/test_client_survives clients/test_client_command
    api/test_repeats api/test_rates api/test_lease
    masks/test_equi_steradian imaging/test_engines jobs/test_fencing jobs/test_refused imaging/test_operators
    imaging/test_thresholding fuzz/test_fuzz benchmarks/test_paper imaging/test_benchmarks
""".split()
"""Files that take longest: where several workers run, the last file to end is a short one."""


def pytest_configure(config):
    """Let hundreds of processes read each other's bytecode, as outside of containers: half of their start; no GPU."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    if find_spec("cupy") is None:  # before anything imports Numba: the GPU's kernels run in its simulator
        os.environ["NUMBA_ENABLE_CUDASIM"] = "1"
    if hasattr(config.option, "loadscopereorder"):  # of pytest-xdist: by the number of tests, which says little here
        config.option.loadscopereorder = False
    config.pluginmanager.register(Budget(config))


def pytest_sessionfinish():
    """Write the covered lines: pytest-xdist kills a worker that takes 10 s to end, and they are lost with it."""
    if "coverage" in sys.modules and (counting := sys.modules["coverage"].Coverage.current()):
        counting.save()


def pytest_ignore_collect(collection_path, config):
    """Leave the browser's tests, and what they import, aside where none is to run; and those of absent data."""
    absent = collection_path == MEASURED and not os.environ.get(MEASURED_DATA)
    return True if absent or (collection_path == WEB and "not browser" in config.option.markexpr) else None


def pytest_terminal_summary(terminalreporter):
    """Say that the measured data were not there: their licence keeps them out of the repository."""
    if not os.environ.get(MEASURED_DATA):
        terminalreporter.write_line(f"measured data: not tried; {MEASURED_DATA} names no folder (CONTRIBUTING.md)")


def pytest_collection_modifyitems(items):
    """Put the longest files first."""
    places = {name: place for place, name in enumerate(LONGEST)}

    def place(item):
        folder, file = item.path.parent.name, item.path.stem
        return places.get(f"{folder}/{file}", places.get(file, len(places)))

    items.sort(key=place)
