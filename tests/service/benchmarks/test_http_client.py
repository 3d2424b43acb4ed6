"""The benchmarks' client: what it does when a connection ends."""

import asyncio

import pytest

from steradian.benchmarks.http_client import Connection

ANSWER = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nok"


@pytest.mark.parametrize(
    ("second", "statuses", "connections"),
    [
        (b"", [200, 200], 2),  # ended while the request was on its way: sent again
        (ANSWER[:20], [200, 0], 1),  # an answer that breaks off is none
        (ANSWER[:-2], [200, 0], 1),
    ],
    ids=["ended", "in the head", "in the body"],
)
def test_a_request_is_sent_again_only_where_a_kept_connection_ended_without_a_word(second, statuses, connections):
    seen = []

    async def serve(reader, writer):
        seen.append(0)
        while await reader.readuntil(b"\r\n\r\n"):
            seen[-1] += 1
            is_last = len(seen) == 1 and seen[0] == 2
            writer.write(second if is_last else ANSWER)
            await writer.drain()
            if is_last:
                return writer.close()
        return None

    async def talk():
        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            client = Connection(f"http://127.0.0.1:{port}")
            answers = [await client.ask("/") for _ in range(2)]
            client.close()
            return [answer.status for answer in answers]

    assert asyncio.run(talk()) == statuses
    assert len(seen) == connections


def test_a_service_that_only_hangs_up_is_asked_once():
    asked = []

    async def serve(reader, writer):
        await reader.readuntil(b"\r\n\r\n")
        asked.append(True)
        writer.close()

    async def talk():
        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            return (await Connection(f"http://127.0.0.1:{port}").ask("/")).status

    assert asyncio.run(talk()) == 0
    assert len(asked) == 1
