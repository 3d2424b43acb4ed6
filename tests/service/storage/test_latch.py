"""The latch of the emergency stop is the same one for every process, from the first moment on."""

import os

from steradian.storage.data_dir.emergency_latch import EmergencyLatch


def test_a_press_between_two_processes_that_make_the_latch_is_not_overwritten(tmp_path, monkeypatch):
    """The second finds no latch, and by the time it has made one the first has been pressed."""
    fsync, pressed = os.fsync, []

    def meanwhile(handle):
        monkeypatch.setattr(os, "fsync", fsync)
        pressed.append(EmergencyLatch(tmp_path).press("Ada", "smoke"))
        return fsync(handle)

    monkeypatch.setattr(os, "fsync", meanwhile)
    late = EmergencyLatch(tmp_path)
    assert [late.active()] == pressed
    assert [EmergencyLatch(tmp_path).active()] == pressed
    late.release(pressed[0].number)
    assert EmergencyLatch(tmp_path).active() is None
    assert sorted(path.name for path in tmp_path.iterdir()) == ["answered", "pressed", "released"]


def test_a_press_that_may_come_again_is_written_though_the_earlier_ones_cannot_be_read(tmp_path):
    """Its number is looked for first; a disk that fails to be read keeps no press from its place."""
    latch = EmergencyLatch(tmp_path)
    unreadable = os.open(tmp_path / "released", os.O_WRONLY)
    os.dup2(unreadable, latch._files["released"])
    os.close(unreadable)
    latch.press("ada", None, "a press of another node")
    assert EmergencyLatch(tmp_path).active().number == "a press of another node"
