"""A worker tells which GPU it reconstructs on."""

from importlib.util import find_spec

from steradian.runtime.gpu import detect_gpu


def test_there_is_none_without_the_extra():
    assert find_spec("cupy") or detect_gpu() is None


def test_it_is_asked_for_its_name(monkeypatch):
    monkeypatch.setenv("STERADIAN_GPU", "simulator")
    monkeypatch.setenv("NUMBA_ENABLE_CUDASIM", "1")
    assert detect_gpu() == "simulator"


def test_what_cannot_be_asked_is_none(monkeypatch):
    monkeypatch.setenv("STERADIAN_GPU", "another")
    monkeypatch.delenv("NUMBA_ENABLE_CUDASIM", raising=False)
    assert find_spec("cupy") or detect_gpu() is None
