"""What the files of a data folder are for, in bytes."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from steradian.storage.disk import size_of
from steradian.storage.paths import DataDirectory
from steradian.storage.tables import ReconstructionRow


def usage(session: Session, data: DataDirectory) -> dict[str, int]:
    """Return the bytes that scans, reconstructions, other jobs, uploads, pictures and the rest hold, by name."""
    volumes = set(session.scalars(select(ReconstructionRow.id)))
    jobs = {folder.name: size_of(folder) for folder in data.job_folders()}
    held = {
        "scans": size_of(data.root / "scans"),
        "reconstructions": sum(size for job, size in jobs.items() if job in volumes),
        "other jobs": sum(size for job, size in jobs.items() if job not in volumes),
        "uploads": size_of(data.uploads),
        "images that jobs share": size_of(data.references),
        "pictures of masks": size_of(data.root / "pictures"),
    }
    return held | {"database and the rest": max(0, size_of(data.root) - sum(held.values()))}
