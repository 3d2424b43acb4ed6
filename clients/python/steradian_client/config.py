"""Service URL and API key from arguments, environment or file."""

from __future__ import annotations

import os
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from steradian_client.errors import ClientError

URL, KEY = "STERADIAN_URL", "STERADIAN_KEY"
DEFAULT: Final = "http://127.0.0.1:8000"


@dataclass(frozen=True)
class Address:
    """URL and API key of a service."""

    url: str
    key: str | None

    @classmethod
    def resolve(
        cls, url: str | None = None, key: str | None = None, environment: Mapping[str, str] = os.environ
    ) -> Self:
        """Return URL and API key from the arguments, the environment or the configuration file (``url``, ``key``).

        A key goes only to the address that it was written beside: never the file's to another address.

        Raises
        ------
        ClientError
            When the file is no TOML.
        """
        if url is None:
            url = environment.get(URL) or None
            key = key or environment.get(KEY) or None
        elif key is None and environment.get(URL, "").rstrip("/") in {"", url.rstrip("/")}:
            key = environment.get(KEY) or None
        kept = _read(config_file(environment))
        if key is None and url in {None, kept.get("url")}:
            key = kept.get("key")
        return cls(url or kept.get("url") or DEFAULT, key)


def config_file(environment: Mapping[str, str] = os.environ) -> Path:
    """Return the path of the configuration file."""
    if sys.platform == "win32":
        base = Path(environment.get("APPDATA") or Path.home() / "AppData" / "Roaming")
    else:
        base = Path(environment.get("XDG_CONFIG_HOME") or Path.home() / ".config")
    return base / "steradian" / "client.toml"


def _read(path: Path) -> dict[str, str]:
    try:
        found = tomllib.loads(path.read_text("utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ClientError(f"{path} is not valid TOML: {error}") from error
    return {name: value for name in ("url", "key") if isinstance(value := found.get(name), str)}
