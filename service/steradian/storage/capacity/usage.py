"""Disk usage of the data folder by category, in bytes."""

from __future__ import annotations

import os
from collections import Counter
from contextlib import suppress

from sqlalchemy import select

from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.db.tables import JobRow


def usage(database: Database, data: DataDirectory) -> dict[str, int]:
    """Return the disk usage in bytes by category: scans, reconstructions, other jobs, uploads, pictures, rest."""
    with database.read() as session:
        volumes = set(session.scalars(select(JobRow.id).where(JobRow.resource == "reconstruction")))
    jobs = {folder: "reconstructions" if folder.name in volumes else "other_jobs" for folder in data.job_folders()}
    others = {
        data.root / "scans": "scans",
        data.uploads: "uploads",
        data.references: "shared_images",
        data.root / "pictures": "mask_pictures",
    }
    names = {str(folder.absolute()): name for folder, name in (jobs | others).items()}
    kinds = ("scans", "reconstructions", "other_jobs", "uploads", "shared_images", "mask_pictures", "database_and_rest")
    held, name_of = Counter(dict.fromkeys(kinds, 0)), dict[str, str]()
    for root, _, files in os.walk(data.root.absolute()):  # once for all
        above = name_of.get(os.path.dirname(root), "database_and_rest")
        name = name_of[root] = names.get(root, above)
        for file in files:
            with suppress(OSError):  # gone meanwhile
                held[name] += os.lstat(os.path.join(root, file)).st_size
    return dict(held)
