"""Requests to one service: JSON in and out, problems as exceptions, downloads written whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import httpx

from steradian_client.errors import ServiceError, Unreachable
from steradian_client.models import Answer

Kind = TypeVar("Kind", bound=Answer)
API = "/api/v1"


class Transport:
    """A connection to a service.

    Parameters
    ----------
    url
        Address of the service, for example ``http://127.0.0.1:8000``.
    timeout
        Seconds to wait for an answer, beyond any wait that is asked of the service itself.
    key
        API key, which a service on another machine asks for.
    """

    def __init__(self, url: str, timeout: float, key: str | None) -> None:
        self._timeout = timeout
        headers = {"User-Agent": "steradian-client"} | ({"Authorization": f"Bearer {key}"} if key else {})
        self._http = httpx.Client(base_url=url.rstrip("/") + API, timeout=timeout, headers=headers)

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def ask(
        self,
        kind: type[Kind],
        method: str,
        path: str,
        *,
        body: dict[str, Any] | None = None,
        headers: dict[str, str] | None = None,
        wait: float = 0.0,
    ) -> Kind:
        """Send a request and read its answer; ``wait`` seconds may pass before the service answers.

        Raises
        ------
        ServiceError, Unreachable
            When the service refuses, or none answers.
        """
        wishes = {"Prefer": f"wait={wait:.0f}"} if wait >= 1 else {}
        try:
            answer = self._http.request(
                method, path, json=body, headers=wishes | (headers or {}), timeout=self._timeout + wait
            )
        except httpx.TransportError as error:
            raise Unreachable(f"no answer from {self._http.base_url}: {error}") from error
        _check(answer)
        return kind.model_validate_json(answer.content)

    def list(self, kind: type[Kind], path: str, limit: int) -> list[Kind]:
        """Read the newest ``limit`` resources, page by page.

        Raises
        ------
        ServiceError, Unreachable
            When the service refuses, or none answers.
        """
        found: list[Kind] = []
        following: str | None = f"{path}?limit={min(limit, 1000)}"
        while following and len(found) < limit:
            try:
                answer = self._http.get(following)
            except httpx.TransportError as error:
                raise Unreachable(f"no answer from {self._http.base_url}: {error}") from error
            _check(answer)
            found += [kind.model_validate(item) for item in answer.json()["items"]]
            following = answer.links.get("next", {}).get("url", "").removeprefix(API) or None
        return found[:limit]

    def download(self, path: str, target: Path, params: dict[str, str] | None = None) -> Path:
        """Save an answer's body; ``target`` appears only when it is whole.

        Raises
        ------
        ServiceError, Unreachable
            When the service refuses, or the connection breaks off.
        """
        draft = target.with_name(target.name + ".part")
        try:
            with self._http.stream("GET", path, params=params) as answer, draft.open("wb") as file:
                if answer.is_error:
                    answer.read()
                _check(answer)
                for piece in answer.iter_bytes():
                    file.write(piece)
            return draft.replace(target)
        except httpx.TransportError as error:
            raise Unreachable(f"the download from {self._http.base_url} broke off: {error}") from error
        finally:
            draft.unlink(missing_ok=True)


def _check(answer: httpx.Response) -> None:
    if not answer.is_error:
        return
    try:
        problem = answer.json()
    except ValueError:
        problem = {"title": answer.reason_phrase}
    raise ServiceError(answer.status_code, problem if isinstance(problem, dict) else {"detail": str(problem)})
