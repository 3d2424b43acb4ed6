"""The benchmarks' client: what it does when a connection ends."""

import asyncio
from contextlib import suppress

import pytest

from steradian.benchmarks.http_client import Connection

ANSWER = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nok"


def statuses_from(replies, asked):
    """Ask a server once for each method in ``asked``; ``replies`` are its answers, of which a short one is its last.

    Returns the statuses, and how many connections it was asked over.
    """
    replies, tasks = list(replies), []

    async def serve(reader, writer):
        tasks.append(asyncio.current_task())
        with suppress(asyncio.IncompleteReadError):
            reply = ANSWER
            while reply == ANSWER and await reader.readuntil(b"\r\n\r\n"):
                reply = replies.pop(0)
                writer.write(reply)
        writer.close()
        await writer.wait_closed()

    async def talk():
        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
            client = Connection(f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}")
            found = [(await client.request("/", method=method)).status for method in asked]
            client.close()
            await asyncio.gather(*tasks)
            return found

    return asyncio.run(talk()), len(tasks)


@pytest.mark.parametrize(
    ("last", "expected"),
    [
        (b"", ([200, 200], 2)),  # ended while the request was on its way: sent again
        (ANSWER[:20], ([200, 0], 1)),  # an answer that breaks off is none
        (ANSWER[:-2], ([200, 0], 1)),
    ],
    ids=["ended", "in the head", "in the body"],
)
def test_get_is_retried_only_if_connection_closed_before_response(last, expected):
    assert statuses_from([ANSWER, last, ANSWER], ["GET", "GET"]) == expected


def test_a_service_that_only_hangs_up_is_asked_once():
    assert statuses_from([b"", ANSWER], ["GET"]) == ([0], 1)


def test_post_is_never_retried():
    assert statuses_from([ANSWER, b"", ANSWER], ["GET", "POST"]) == ([200, 0], 1)
