"""What holds for a whole run: the order of the files, and that started programs keep their bytecode."""

import gc
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest

from support import copies, warmed
from support.budget import Budget

WEB, MEASURED = (Path(__file__).with_name(name) for name in ("web", "measured"))
MEASURED_DATA = "STERADIAN_MEASURED_DATA"
"""Variable of the environment that names the folder of measured data."""
LONGEST = """
    imaging/test_late_records test_hardware_page docs/test_first_hour reconstructions/test_compiling crash/test_crash
    reconstructions/test_medium_search test_width crash/test_fenced web/test_stop_shown web/test_whole
    scans/test_attacking_files crash/test_backup test_emergency_stop cluster/test_cut cluster/test_stop
    cli/test_terminal cluster/test_nodes jobs/test_capabilities api/test_contract api/test_attacks
    comparisons/test_comparison runtime/test_work api/test_sent_on clients/test_matlab
    driver/test_emergency_stops driver/test_monitor benchmarks/test_tuning imaging/test_windows
    scans/test_import_guarded clients/test_python_client jobs/test_queue api/test_expensive
    driver/test_control_socket scans/test_port_watch api/test_conventions jobs/test_fencing cli/test_commands
    driver/test_driver_command driver/test_simulator runtime/test_inspection api/test_retiring
    api/test_resources api/test_stop_ticket
""".split()
"""Files that take longest: where several workers run, the last file to end is a short one.

Those whose kernels are compiled first stand apart: beside each other they would all wait for one that compiles.
"""


def pytest_configure(config):
    """Let hundreds of processes read each other's bytecode, as outside of containers: half of their start; no GPU."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    if hasattr(config, "workerinput") and os.environ.get("STERADIAN_COVERAGE") == "own":
        os.environ.pop("COVERAGE_PROCESS_START", None)  # this process counts lines, those that its tests start do not
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # more of them in each of several processes only wait
    if find_spec("cupy") is None:  # before anything imports Numba: the GPU's kernels run in its simulator
        os.environ["NUMBA_ENABLE_CUDASIM"] = "1"
    if hasattr(config.option, "loadscopereorder"):  # of pytest-xdist: by the number of tests, which says little here
        config.option.loadscopereorder = False
    config.pluginmanager.register(Budget(config))
    warmed.INHERITED.update(os.environ)
    gc.disable()  # a quarter of the collection's time


def pytest_collection_finish():
    """Collect garbage again, but never look at the objects of the collection of tests."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _simulators_are_copies():
    """Start simulators as copies of one process, which takes a tenth of their own start."""
    from fabry_perot.simulator import launcher  # with NumPy, which reads the variables that are set below

    copying = SimpleNamespace(**vars(subprocess) | {"Popen": copies.Popen})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(launcher, "subprocess", copying)
        yield


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
