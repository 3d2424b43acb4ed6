"""A worker tells which GPU it reconstructs on."""

from importlib.util import find_spec

from steradian.runtime.gpu_detection import detect_gpu


def test_there_is_none_without_the_extra():
    assert find_spec("cupy") or detect_gpu() is None


def test_it_is_asked_for_its_name(monkeypatch):
    monkeypatch.setenv("STERADIAN_GPU", "simulator")
    monkeypatch.setenv("NUMBA_ENABLE_CUDASIM", "1")
    assert detect_gpu() == "simulator"


def test_detect_gpu_with_unknown_backend_returns_none(monkeypatch):
    monkeypatch.setenv("STERADIAN_GPU", "another")
    monkeypatch.delenv("NUMBA_ENABLE_CUDASIM", raising=False)
    assert find_spec("cupy") or detect_gpu() is None
