"""The example for Kubernetes in the eyes of a schema checker."""

from pathlib import Path

import pytest

pytestmark = pytest.mark.long
MANIFEST = Path(__file__).parents[2] / "container" / "kubernetes.yaml"


def check(tools, path):
    return tools.ask("kubernetes-validate", "--strict", path)


def test_every_resource_is_one_that_kubernetes_knows(tools):
    ran = check(tools, MANIFEST)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    passed = [line.split(" resource ")[1].split(" against ")[0] for line in ran.stdout.splitlines() if "passed" in line]
    assert passed == [
        "service/steradian", "deployment/api", "service/scanner-0", "statefulset/scanner-0", "deployment/worker",
    ]  # fmt: skip


@pytest.mark.parametrize(("right", "wrong"), [("replicas: 2", "replicas: two"), ("readinessProbe:", "readyProbe:")])
def test_a_slip_is_noticed(tools, tmp_path, right, wrong):
    manifest = tmp_path / "slip.yaml"
    manifest.write_text(MANIFEST.read_text().replace(right, wrong, 1))
    assert check(tools, manifest).returncode != 0
