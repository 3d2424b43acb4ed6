"""Decorators that expose one coroutine function as a blocking and as an asynchronous method.

Every method is written once, as a coroutine. With an awaited transport it is awaited by the caller; with a blocking
one, whose every wait is over when it returns, the coroutine is run to its end on the spot.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import (
    AsyncGenerator,
    AsyncIterator,
    Callable,
    Coroutine,
    Generator,
    Iterator,
)
from typing import TYPE_CHECKING, Any, Concatenate, Final, Generic, ParamSpec, Self, TypeVar, overload

if TYPE_CHECKING:
    from steradian_client.request_session import RequestSession


class SyncMode:
    """Type marker of blocking clients."""


class AsyncMode:
    """Type marker of asynchronous clients."""


Mode = TypeVar("Mode", SyncMode, AsyncMode)
P = ParamSpec("P")
T = TypeVar("T")
_END: Final = object()


class Resource(Generic[Mode]):
    """Base class of resource collections, generic in the client's mode (blocking or asynchronous)."""

    def __init__(self, session: RequestSession) -> None:
        self._session = session


class dual_method(Generic[P, T]):  # noqa: N801 - a decorator
    """Decorator that makes a coroutine function a blocking or an awaitable method, depending on the client."""

    def __init__(self, function: Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]) -> None:
        self._function = function
        self.__doc__ = function.__doc__

    @overload
    def __get__(self, owner: None, kind: type[Any]) -> Self: ...
    @overload
    def __get__(self, owner: Resource[SyncMode], kind: type[Any]) -> Callable[P, T]: ...
    @overload
    def __get__(self, owner: Resource[AsyncMode], kind: type[Any]) -> Callable[P, Coroutine[Any, Any, T]]: ...

    def __get__(self, owner: Any, kind: type[Any]) -> Any:
        if owner is None:
            return self
        bound: Callable[P, Coroutine[Any, Any, T]] = self._function.__get__(owner, kind)
        if not owner._session.transport.blocks:
            return bound

        @functools.wraps(bound)
        def call(*arguments: P.args, **named: P.kwargs) -> T:
            return finish(bound(*arguments, **named))

        return call


class dual_iterator(Generic[P, T]):  # noqa: N801 - a decorator
    """Decorator that makes an async generator a plain or an async iterator, depending on the client."""

    def __init__(self, function: Callable[Concatenate[Any, P], AsyncGenerator[T, None]]) -> None:
        self._function = function
        self.__doc__ = function.__doc__

    @overload
    def __get__(self, owner: None, kind: type[Any]) -> Self: ...
    @overload
    def __get__(self, owner: Resource[SyncMode], kind: type[Any]) -> Callable[P, Generator[T, None, None]]: ...
    @overload
    def __get__(self, owner: Resource[AsyncMode], kind: type[Any]) -> Callable[P, AsyncGenerator[T, None]]: ...

    def __get__(self, owner: Any, kind: type[Any]) -> Any:
        if owner is None:
            return self
        bound = self._function.__get__(owner, kind)
        if not owner._session.transport.blocks:
            return bound

        @functools.wraps(bound)
        def call(*arguments: P.args, **named: P.kwargs) -> Generator[T, None, None]:
            return _each(bound(*arguments, **named))

        return call


class dual_context_manager(Generic[P, T]):  # noqa: N801 - a decorator
    """Decorator that makes an async generator a plain or an async context manager, depending on the client."""

    def __init__(self, function: Callable[Concatenate[Any, P], AsyncIterator[T]]) -> None:
        self._function = contextlib.asynccontextmanager(function)
        self.__doc__ = function.__doc__

    @overload
    def __get__(self, owner: None, kind: type[Any]) -> Self: ...
    @overload
    def __get__(
        self, owner: Resource[SyncMode], kind: type[Any]
    ) -> Callable[P, contextlib.AbstractContextManager[T]]: ...
    @overload
    def __get__(
        self, owner: Resource[AsyncMode], kind: type[Any]
    ) -> Callable[P, contextlib.AbstractAsyncContextManager[T]]: ...

    def __get__(self, owner: Any, kind: type[Any]) -> Any:
        if owner is None:
            return self
        bound = functools.partial(self._function, owner)
        if not owner._session.transport.blocks:
            return bound

        @contextlib.contextmanager
        @functools.wraps(self._function)
        def call(*arguments: P.args, **named: P.kwargs) -> Iterator[T]:
            with contextlib.ExitStack() as stack:
                inner = bound(*arguments, **named)
                value = finish(inner.__aenter__())
                stack.push(lambda *raised: finish(inner.__aexit__(*raised)))
                yield value

        return call


def finish(coroutine: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine of a blocking transport to its end, without an event loop."""
    try:
        coroutine.send(None)
    except StopIteration as end:
        result: T = end.value
        return result
    coroutine.close()
    raise RuntimeError("a blocking client was made to wait for an event loop")


def _each(source: AsyncGenerator[T, None]) -> Generator[T, None, None]:
    async def following() -> Any:
        return await anext(source, _END)

    try:
        while (item := finish(following())) is not _END:
            yield item
    finally:
        finish(_closed(source))


async def _closed(source: AsyncGenerator[Any, None]) -> None:
    await source.aclose()
