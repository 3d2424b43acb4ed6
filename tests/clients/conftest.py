import subprocess
import sys

import pytest


@pytest.fixture(scope="session")
def url(tmp_path_factory):
    """Address of a running service with a simulated scanner."""
    data = tmp_path_factory.mktemp("data")
    command = [sys.executable, "-m", "steradian", "serve", "--port", "0", "--data", str(data)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield process.stdout.readline().partition(" at ")[2].split()[0].removesuffix("/api/v1/")
    finally:
        process.terminate()
        process.wait(60)
        process.stdout.close()
