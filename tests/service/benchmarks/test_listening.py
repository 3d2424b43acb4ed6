"""What the benchmarks' listeners say of events: none is lost or told again unnoticed."""

import asyncio
from contextlib import asynccontextmanager, suppress

import pytest

from steradian.benchmarks import event_listeners
from steradian.benchmarks.event_listeners import DeliveryReport, compare


def frames(numbers):
    told = [b"event: ready\ndata: {}\nid: e.%d\nretry: 1000\n\n" % numbers[0]]
    told += [b'event: job\ndata: {"id": "x"}\nid: e.%d\n\n' % number for number in numbers[1:]]
    return b"".join(b"%x\r\n%s\r\n" % (len(frame), frame) for frame in [*told, b"event: progress\ndata: {}\n\n"])


@asynccontextmanager
async def log_of(numbers, heard, whole=None):
    """Serve streams as the service writes them: to those who come first what ``heard`` says, then the ``whole`` log."""
    streams, tasks = list(heard), []

    async def serve(reader, writer):
        tasks.append(asyncio.current_task())
        if b"Last-Event-ID" in await reader.readuntil(b"\r\n\r\n"):
            said = streams.pop(0) if streams else whole or numbers
        else:  # one who asks for the newest
            said = numbers[:1] if streams else numbers[-1:]
        with suppress(ConnectionError):
            writer.write(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n" + frames(said))
            await reader.read()
        writer.close()

    async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
        yield f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    await asyncio.gather(*tasks)


async def met(numbers, heard, whole=None):
    async with log_of(numbers, heard, whole) as url, event_listeners.open_listeners([url], len(heard)) as listeners:
        async with asyncio.timeout(250):
            for listener, one in zip(listeners, heard, strict=True):
                await listener.wait_for(one[-1])
        return await compare(listeners)


@pytest.mark.parametrize(
    ("heard", "told"),
    [
        ([[4, 5, 6, 7]] * 3, DeliveryReport(9, 0, 0)),
        ([[4, 5, 6, 7], [4, 5, 7]], DeliveryReport(5, 1, 0)),
        ([[4, 5, 5, 6, 7], [4, 5, 6, 7]], DeliveryReport(7, 0, 1)),
        ([[4, 5, 6, 7, 8]], DeliveryReport(3, 0, 0)),
    ],
    ids=["all", "one is lost", "one comes again", "what comes later"],
)
def test_delivery_report_counts_lost_and_repeated_events(heard, told):
    assert asyncio.run(met([4, 5, 6, 7], heard)) == told


def test_a_stream_that_ends_early_has_lost_the_rest(monkeypatch):
    monkeypatch.setattr(event_listeners, "PATIENCE", 0.5)
    assert asyncio.run(met([4, 5, 6, 7], [[4, 5]])) == DeliveryReport(1, 2, 0)


def test_truncated_event_log_raises_runtime_error(monkeypatch):
    monkeypatch.setattr(event_listeners, "PATIENCE", 0.5)
    with pytest.raises(RuntimeError, match="as far as event 7"):
        asyncio.run(met([4, 5, 6, 7], [[4, 5]], whole=[4, 5]))
