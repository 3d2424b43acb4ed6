"""What the files of a data folder are for, in bytes."""

from __future__ import annotations

from sqlalchemy import select

from steradian.storage.database import Database
from steradian.storage.disk import size_of
from steradian.storage.paths import DataDirectory
from steradian.storage.tables import ReconstructionRow


def usage(database: Database, data: DataDirectory) -> dict[str, int]:
    """Return the bytes that scans, reconstructions, other jobs, uploads, pictures and the rest hold, by name."""
    with database.read() as session:
        volumes = set(session.scalars(select(ReconstructionRow.id)))
    jobs = {folder.name: size_of(folder) for folder in data.job_folders()}
    held = {
        "scans": size_of(data.root / "scans"),
        "reconstructions": sum(size for job, size in jobs.items() if job in volumes),
        "other_jobs": sum(size for job, size in jobs.items() if job not in volumes),
        "uploads": size_of(data.uploads),
        "shared_images": size_of(data.references),
        "mask_pictures": size_of(data.root / "pictures"),
    }
    return held | {"database_and_rest": max(0, size_of(data.root) - sum(held.values()))}
