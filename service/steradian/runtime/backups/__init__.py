"""Backups of a service's data: creation, verification and restore.

BACKUP/manifest.json    what is in it, with sizes and SHA-256; written last: without it the folder is no backup
BACKUP/database.sqlite  metadata, whichever database the service uses, and of an embedded one the queue
BACKUP/scans, jobs, …   files, as they lie in the data folder
"""

from steradian.runtime.backups.create import create_backup
from steradian.runtime.backups.manifest import Manifest
from steradian.runtime.backups.restoration import restore

__all__ = ["Manifest", "create_backup", "restore"]
