"""Benchmark of the scanner link: decoding of A-lines against raw reads of the port, and a scan under load."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from steradian.core.progress import Progress

Row: TypeAlias = dict[str, Any]
SAMPLES = 1024
_PLAN, _SESSION, _BOOT = 0xBE7C, 0x0102, 0xB007
_BATCH = 64
"""A-lines that the application takes at a time, as (n, N_t) int16: durable writes are not made one by one."""
_STAGES = ("pty", "socket", "sustained")


def link(*, quick: bool = False, progress: Progress | None = None) -> list[Row]:
    """Measure the throughput of the scanner link: decoding on each transport, and a sustained scan.

    Parameters
    ----------
    quick
        Small versions: a check that they run, no measurement.
    progress
        Called before each measurement.

    Returns
    -------
    list of dict
        ``pty`` and ``socket``: ``raw_mb_s`` read by the driver's transport (its buffer, pyserial) without looking,
        ``decoded_mb_s`` and ``alines_s`` through the whole host into (n, N_t) int16, ``ratio`` of the two, medians of
        pieces read in turns from one stream; ``recv_mb_s`` is the bare system call with 64 KiB, for comparison.
        ``sustained``: ``alines_s`` from a simulated scanner
        through the driver into a scan file, every batch synchronised to the disk, while ``loads`` reconstruction
        processes keep all cores busy; ``ring_peak`` A-lines of ``ring`` that the device held at worst; ``lapses`` of
        the laser's lease.
    """
    rows: list[Row] = []
    for done, stage in enumerate(_STAGES):
        if progress is not None:
            progress(stage, done, len(_STAGES))
        rows.append(_measure_sustained(quick) if stage == "sustained" else _port(stage, quick))
    if progress is not None:
        progress("done", len(_STAGES), len(_STAGES))
    return rows


def _port(kind: str, quick: bool) -> Row:
    """Measure the throughput of raw reads and of decoding, alternately on one stream so that both see equal load."""
    count, rounds = (300, 1) if quick else (3_000, 9)
    size = sum(map(len, _frames(kind, count)))
    raw, decoded = _in_turns(kind, count, rounds, size)
    raw_s, decoded_s = float(np.median(raw)), float(np.median(decoded))
    row = {
        "what": kind,
        "samples": SAMPLES,
        "raw_mb_s": size / raw_s / 1e6,
        "decoded_mb_s": size / decoded_s / 1e6,
        "alines_s": count / decoded_s,
        "ratio": float(np.median(raw / decoded)),
    }
    if kind == "socket":
        row["recv_mb_s"] = size * rounds / _raw_recv_seconds(count, rounds, size * rounds) / 1e6
    return row


def _frames(kind: str, count: int) -> Iterator[bytes]:
    """Yield the encoded frames of ``count`` A-lines as a device with a full ring buffer sends them."""
    from fabry_perot.device.ring_buffer import ALineRingBuffer
    from fabry_perot.wire.constants import MAX_GROUP, Type
    from fabry_perot.wire.framing import MAX_PAYLOAD, USB_PAYLOAD, Frame, crc32c, encode_frame
    from fabry_perot.wire.messages import ALineMeta, pack

    samples = np.random.default_rng(0).normal(0, 3000, (16, SAMPLES)).astype("<i2")
    ring = ALineRingBuffer(count)
    ring.clear(_PLAN)
    ring.group = MAX_GROUP
    ring.acknowledge(0, count, [])
    for number in range(count):
        data = samples[number % 16].tobytes()
        meta = ALineMeta(number, 1_550_000, number, crc32c(data), 1.0, 8000, SAMPLES, 1, 10_000, 1200, 0, 0, 0)
        ring.append(number, pack(meta) + data)
    sequence, payload = 0, MAX_PAYLOAD if kind == "socket" else USB_PAYLOAD
    while (part := ring.next_payload(payload)) is not None:
        yield encode_frame(Frame(Type.ALINE, 0, _BOOT & 0xFF, _SESSION, sequence & 0xFFFF, part[0]))
        sequence += 1


def _in_turns(kind: str, count: int, rounds: int, size: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the durations of alternate chunks of ``count`` A-lines: read without decoding, and decoded."""
    from fabry_perot.host.transport import open_transport

    times: list[float] = []
    with _sender_process(kind, count, 2 * rounds) as url:
        transport = open_transport(url)
        try:
            transport.write(b"go")
            data = b""
            while not data:
                data = transport.read()
            for turn in range(2 * rounds):
                begin = time.perf_counter()
                data = _decode(transport, data, count) if turn % 2 else _read_remaining(transport, data, size)
                times.append(time.perf_counter() - begin)
        finally:
            transport.close()
    return np.array(times[::2]), np.array(times[1::2])


def _read_remaining(transport: Any, data: bytes, left: int) -> bytes:
    """Read ``left`` bytes, counting those of ``data``; return the surplus bytes."""
    while left > len(data):
        left -= len(data)
        data = transport.read()
    return data[left:]


def _decode(transport: Any, data: bytes, count: int) -> bytes:
    """Decode ``count`` A-lines from the transport; return the surplus bytes, which belong to the next chunk."""
    from fabry_perot.host import Host
    from fabry_perot.wire.messages import HelloAck

    host = Host(1)
    host.hello = HelloAck(1, _BOOT, _SESSION, 1, 1, 5, 1, 32768, count, 0, 0, _PLAN, count, 0, 0, 0, 0)
    host.receive_from(_PLAN, 0)
    assert host.assembly is not None
    delivered = 0
    while True:
        host.receive(data, 0)
        here = host.assembly.complete
        if here - delivered >= min(_BATCH, count - delivered):
            delivered += len(host.take().samples)
            if delivered >= count:
                return data[data.rfind(b"\0\0") + 1 :] if b"\0\0" in data else b""
        host.take_output()
        data = transport.read()


def _raw_recv_seconds(count: int, rounds: int, left: int) -> float:
    """Time bare ``recv`` calls of 64 KiB on the same stream, as the upper bound of the socket's throughput."""
    with _sender_process("socket", count, rounds) as url:
        host, port = url.removeprefix("socket://").rsplit(":", 1)
        with socket.create_connection((host, int(port))) as plain:
            plain.sendall(b"go")
            left -= len(plain.recv(65536))
            begin = time.perf_counter()
            while left > 0:
                left -= len(plain.recv(65536))
            return time.perf_counter() - begin


@contextmanager
def _sender_process(kind: str, count: int, pieces: int) -> Iterator[str]:
    """Run this module as a sender process, and yield the URL of its port."""
    command = [sys.executable, "-P", "-m", "steradian_benchmarks.link_throughput", kind, str(count), str(pieces)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.PIPE)
    assert process.stdout is not None and process.stdin is not None  # noqa: PT018
    try:
        yield process.stdout.readline().decode().strip()
    finally:
        process.stdin.close()
        process.kill()
        process.wait()
        process.stdout.close()


def _send(kind: str, count: int, pieces: int) -> None:
    """Run the sender process: print the port, wait for the reader, write the stream, exit on request."""
    piece = memoryview(b"".join(_frames(kind, count)))
    if kind == "pty":
        master, slave = os.openpty()
        tty.setraw(slave)
        sys.stdout.write(os.ttyname(slave) + "\n")
    else:
        listener = socket.create_server(("127.0.0.1", 0))
        sys.stdout.write("socket://{}:{}\n".format(*listener.getsockname()))
        sys.stdout.flush()
        connection, _ = listener.accept()
        master = connection.fileno()
    sys.stdout.flush()
    os.read(master, 2)
    for _ in range(pieces):
        data = piece
        while data:
            data = data[os.write(master, data[:65536]) :]
    sys.stdin.read()


def _measure_sustained(quick: bool) -> Row:
    """Measure a scan at 2,500 pulses a second into a scan file while reconstructions load the machine."""
    import fabry_perot
    from fabry_perot.simulator import launch
    from steradian.masks import grid_mask
    from steradian.plans import ScanPlan
    from steradian.scans.file.writer import ScanFileWriter, create_scan_file

    side, loads, ring = (12, 1, 4096) if quick else (141, 2, 4096)
    mask = grid_mask(aperture=20e-6 * side, count=side, interval=20e-6)
    plan = ScanPlan(mask=mask, pulse_rate=2_500.0, samples=SAMPLES, sampling_interval=8e-9)
    folder = Path(tempfile.mkdtemp(prefix="steradian-link-"))
    try:
        create_scan_file(folder / "scan.h5", plan)
        with (
            ScanFileWriter(folder / "scan.h5") as store,
            launch(repeat=64, ring=ring) as simulator,
            fabry_perot.connect(simulator.url) as scanner,
            _reconstructions(loads),
        ):
            points = np.zeros((mask.count, 2))  # the mirrors' settling would be the bottleneck otherwise
            scanner.upload(points, samples=SAMPLES, sampling_interval=8e-9, pulse_rate=2_500.0)
            begin = time.perf_counter()
            lapses = _acquire(scanner, store)
            seconds = time.perf_counter() - begin
            peak = simulator.send_command("report")["ring_peak"]
            stored = store.stored
    finally:
        shutil.rmtree(folder)
    return {
        "what": "sustained",
        "samples": SAMPLES,
        "alines_s": stored / seconds,
        "seconds": seconds,
        "loads": loads,
        "ring_peak": peak,
        "ring": ring,
        "lapses": lapses,
    }


def _acquire(scanner: Any, store: Any) -> int:
    """Run a whole scan into a scan file as ``run_scan`` does; return the number of lapses of the laser's lease."""
    import fabry_perot

    lapses = 0
    scanner.start(scanner.arm())
    while True:
        try:
            for batch in scanner.alines():
                store.append(batch)
                scanner.acknowledge(batch[-1])
            return lapses
        except fabry_perot.LeaseExpired:
            lapses += 1
            scanner.resume()


@contextmanager
def _reconstructions(count: int) -> Iterator[None]:
    """Run ``count`` load processes that reconstruct continuously, until the block ends."""
    command = [sys.executable, "-P", "-m", "steradian_benchmarks.link_throughput", "load"]
    loads = [subprocess.Popen(command, stdout=subprocess.PIPE) for _ in range(count)]
    try:
        for process in loads:
            assert process.stdout is not None
            process.stdout.readline()
        yield
    finally:
        for process in loads:
            process.kill()
            process.wait()
            if process.stdout is not None:
                process.stdout.close()


def _load() -> None:
    """Run a load process: reconstruct until killed."""
    from steradian.imaging import AcquisitionGeometry, Compute, ImageGrid, ReconstructionPlan

    axis = (np.arange(41) - 20) * 300e-6
    positions = np.column_stack([grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij")])
    traces = np.random.default_rng(0).standard_normal((len(positions), 512)).astype(np.float32)
    geometry = AcquisitionGeometry(positions, 512, dt=8e-9, sound_speed=1500.0, aperture=12.3e-3)
    plan = ReconstructionPlan(geometry, ImageGrid(123), compute=Compute(device="cpu", threads=1))
    plan.run(traces)
    sys.stdout.write("busy\n")
    sys.stdout.flush()
    while True:
        plan.run(traces)


if __name__ == "__main__":
    if sys.argv[1] == "load":
        _load()
    else:
        _send(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
