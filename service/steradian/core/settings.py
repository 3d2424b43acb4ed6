"""Deployment settings: one immutable object, read from environment variables ``STERADIAN_…``."""

from __future__ import annotations

import os
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from steradian.core.exceptions import InvalidInput
from steradian.core.system_resources import cpu_count
from steradian.core.validation_errors import to_invalid_input

PREFIX = "STERADIAN_"
DEFAULT_SCANNER_ID = "scanner-0"
"""What the scanner is called where there is one."""
ROOT_PATH = r"^((/[A-Za-z0-9_~-][A-Za-z0-9._~-]*){1,8}/?)?$"
"""A path below which a proxy serves: segments of letters, digits and ``._~-``, none of which begins with a dot."""
_ORIGIN = r"https?://([A-Za-z0-9.-]{1,253}|\[[0-9A-Fa-f:.]{2,45}\])(:[0-9]{1,5})?"
ORIGINS = rf"^ *({_ORIGIN}( *, *{_ORIGIN})* *)?$"
"""Origins as browsers write them, without a path; neither ``*`` nor ``null`` is one."""
OWN_PATHS = frozenset(
    {"api", "data", "design", "docs", "healthz", "metrics", "openapi.json", "problems", "readyz", "reconstructions"}
    | {"scans", "static", "volumes"}
)
"""First segments of the service's own addresses."""
SECRETS = frozenset({f"{PREFIX}API_KEY", f"{PREFIX}NODE_SECRET"})
"""Variables that only processes get which answer requests."""


class Settings(BaseModel):
    """Settings of the service, its processes and its object store."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    data: Path = Field(description="Data folder of the service; created if missing")
    host: str = Field(default="127.0.0.1", description="Address to listen on")
    port: int = Field(default=8000, ge=0, le=65_535, description="Port to listen on; 0 takes a free one")
    root_path: str = Field(
        default="",
        max_length=200,
        pattern=ROOT_PATH,
        description="Path below which a proxy serves this service, /steradian for example; none: X-Forwarded-Prefix's",
    )
    workers: int = Field(default=1, ge=0, le=64, description="Reconstructions at a time, a process each")
    scanner: str = Field(
        default="simulated",
        min_length=1,
        description="'simulated', a serial port such as /dev/ttyUSB0 or /dev/ttyUSB0?baud=921600, or socket://host:port",
    )
    scanner_id: str = Field(
        default=DEFAULT_SCANNER_ID,
        pattern=r"^[a-z0-9][a-z0-9-]{0,39}$",
        description="Name of this node's scanner; each scanner of a service needs its own",
    )
    scanner_watch: bool = Field(
        default=True,
        description="Whether the scanner's port is held and listened to between scans; if not, laser, shutter,"
        " interlock and key are unknown between them",
    )
    simulator_speed: float = Field(
        default=20.0, gt=0, le=10_000, description="How many times faster than real the simulated scanner runs"
    )
    resume_within: float = Field(
        default=2.0,
        ge=0,
        le=10,
        description="Time after an interruption within which the laser may resume automatically; 0: never (s)",
    )
    database_url: str | None = Field(
        default=None,
        repr=False,
        pattern=r"^postgres(ql)?(\+psycopg)?://",
        description="PostgreSQL database for metadata and queue, postgresql://…; none: SQLite files in the data folder",
    )
    store: str | None = Field(
        default=None,
        pattern=r"^s3://[a-z0-9][a-z0-9.-]{1,61}[a-z0-9](/[A-Za-z0-9._/-]*)?$",
        description="S3-compatible store for scans and results, s3://bucket/prefix; none: the data folder",
    )
    store_endpoint: str | None = Field(
        default=None, pattern=r"^https?://[^/@]+/?$", description="Address of a store that is not Amazon's, https://…"
    )
    store_cache_bytes: int = Field(
        default=20 * 2**30, ge=2**20, description="Copies of the store's files on this machine (bytes)"
    )
    role: Literal["service", "api", "acquisition"] = Field(
        default="service", description="Role of this node: a whole service, one of its API nodes, or a scanner's node"
    )
    node_secret: str | None = Field(
        default=None,
        repr=False,
        min_length=32,
        pattern=r"^[!-~]+$",
        description="Shared secret by which the nodes of one service authenticate (letters, digits, signs of ASCII)",
    )
    address: str | None = Field(
        default=None,
        pattern=r"^https?://[^/@]+$",
        description="Address by which other nodes reach this one, http://host:port; none: the listening address",
    )
    worker_name: str = Field(
        default="worker",
        pattern=r"^[A-Za-z0-9._-]{1,100}$",
        description="Name of this host's workers; each host on one database needs its own",
    )
    worker_memory_bytes: int | None = Field(
        default=None,
        ge=2**20,
        description="Memory that a worker here claims to have; none: the machine's or the container's (bytes)",
    )
    await_workers: bool = Field(
        default=False,
        description="Whether jobs are taken that no worker of the last hour can do: one that can is started for them",
    )
    drain_seconds: float = Field(
        default=0.0, ge=0, le=86_400, description="How long a worker that is to end may finish its job (s)"
    )
    api_key: str | None = Field(
        default=None, repr=False, min_length=20, description="A key with every scope (at least 20 characters)"
    )
    require_key: bool = Field(
        default=False, description="Whether a key is needed on the loopback, too: for a machine with other users"
    )
    requests_per_second: float = Field(
        default=100.0,
        gt=0,
        description="Requests a key may make in the long run; a change counts as 5 (1/s)",
    )
    failed_keys_per_minute: float = Field(
        default=20.0, ge=1, description="Failed keys after which an address is accepted only with a known key (1/min)"
    )
    key_file: Path | None = Field(
        default=None, description="File in which a first start writes an admin key, if there is no other"
    )
    allowed_hosts: str = Field(
        default="", description="Host names, besides the loopback's, by which a service without keys may be addressed"
    )
    cors_origins: str = Field(
        default="",
        pattern=ORIGINS,
        description="Origins whose pages may read, https://viewer.example, separated by commas; none: no page",
    )
    page_scripts: Path | None = Field(
        default=None,
        description="Folder with a laboratory's own scripts (.js), which every page runs; none: no scripts",
    )
    retention_days: float | None = Field(
        default=None, gt=0, description="Days after which finished reconstructions are deleted; none: kept"
    )
    event_days: float = Field(default=7.0, gt=0, description="Days for which the event log can be replayed")
    log_format: Literal["text", "json"] = "text"
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = "INFO"
    max_mask_points: int = Field(default=200_000, ge=1, description="Largest mask accepted over HTTP (points)")
    max_upload_bytes: int = Field(default=64 * 2**20, ge=1024, description="Largest request body (bytes)")
    max_import_bytes: int = Field(default=4 * 2**30, ge=1024, description="Largest file that can be imported (bytes)")
    max_connections: int = Field(default=2000, ge=10, le=100_000, description="HTTP connections at a time")
    client_timeout: float = Field(
        default=20.0, gt=0, le=3600, description="Seconds for which a client may send nothing of a request it began (s)"
    )
    keep_alive: float = Field(
        default=90.0,
        gt=0,
        le=3600,
        description="Seconds for which an idle connection is kept, longer than proxies keep theirs (s)",
    )
    max_volume_bytes: int = Field(default=8 * 2**30, ge=2**20, description="Largest volume a job may make (bytes)")
    disk_reserve_bytes: int = Field(
        default=100 * 2**20, ge=0, description="Free space of the disk that uploads and jobs leave (bytes)"
    )
    job_timeout: float = Field(default=6 * 3600.0, gt=0, le=30 * 86_400, description="Longest a job may run (s)")

    @classmethod
    def create(cls, **fields: Any) -> Self:
        """Return the settings from environment variables, overridden by ``fields`` that are not ``None``.

        Raises
        ------
        InvalidInput
            Naming the setting and its allowed range.
        """
        variables = {name.upper(): value for name, value in os.environ.items()}
        given = {name: variables[key] for name in cls.model_fields if (key := PREFIX + name.upper()) in variables}
        try:
            settings = cls(**given | {name: value for name, value in fields.items() if value is not None})
        except ValidationError as error:
            raise to_invalid_input(cls, error) from error
        if settings.database_url is not None:  # one spelling for every library
            url = "postgresql" + settings.database_url[settings.database_url.index("://") :]
            settings = settings.model_copy(update={"database_url": url})
        elif settings.store is not None:
            allowed = "none without STERADIAN_DATABASE_URL: all hosts must share the records of a store"
            raise InvalidInput("store", settings.store, allowed)
        if "?" in settings.scanner:
            settings._check_baud()
        if settings.root_path.split("/")[1:2] and settings.root_path.split("/")[1] in OWN_PATHS:
            allowed = f"a path that begins with none of the service's own ({', '.join(sorted(OWN_PATHS))})"
            raise InvalidInput("root_path", settings.root_path, allowed)
        return settings

    def _check_baud(self) -> None:
        """Raise InvalidInput if the scanner's address has an invalid baud rate."""
        from fabry_perot import PlanInvalid
        from fabry_perot.host.address import split

        try:
            split(self.scanner)
        except PlanInvalid as error:
            raise InvalidInput("scanner", self.scanner, f"a port with {error.field} of {error.allowed}") from error

    @property
    def has_scanner(self) -> bool:
        """Whether this node has a scanner, simulated or real."""
        return self.role != "api"

    @property
    def simulated(self) -> bool:
        """Whether the scanner is the simulator that the service starts."""
        return self.scanner == "simulated"

    @property
    def listens_on_loopback(self) -> bool:
        """Whether the service listens on a loopback address only."""
        name = self.host.lower().removesuffix(".")
        try:
            return name == "localhost" or ip_address(name).is_loopback
        except ValueError:
            return False

    @property
    def needs_key(self) -> bool:
        """Whether every request requires a key."""
        return self.require_key or not self.listens_on_loopback

    @property
    def origins(self) -> frozenset[str]:
        """Allowed CORS origins, in lower case."""
        return frozenset(name.strip().lower() for name in self.cors_origins.split(",") if name.strip())

    @property
    def is_scanner_node(self) -> bool:
        """Whether this node's workers run only live jobs of its own scanner."""
        return self.role == "acquisition" and self.workers > 0

    def worker_slot_name(self, slot: int) -> str:
        """Return the name of the worker with a slot number."""
        return f"{self.scanner_id if self.role == 'acquisition' else self.worker_name}-{slot}"

    @property
    def threads_per_job(self) -> int:
        """Threads per job: the number of CPUs divided by the number of workers."""
        return max(1, cpu_count() // max(1, self.workers))

    def environment(self, *, keys: bool = True) -> dict[str, str]:
        """Return environment variables with these settings for a child process; :data:`SECRETS` only with ``keys``."""
        values = {PREFIX + name.upper(): str(v) for name, v in self.model_dump(mode="json", exclude_none=True).items()}
        whole = os.environ | values
        return whole if keys else {name: value for name, value in whole.items() if name not in SECRETS}
