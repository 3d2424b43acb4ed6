"""The API of a scanner's node, and one without a scanner: on one database, which is all that matters between them."""

import httpx

from steradian.storage.data_dir.emergency_latch import EmergencyLatch
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository
from support.apis import ApiProcess

SECRET = "-".join(["nodes", "of", "tests", "know", "this", "and", "no", "log", "does"])

NOBODY = "http://127.0.0.1:9"
"""An address where nobody answers."""


class Pair:
    """Both, and a client of the one without a scanner."""

    def __init__(self, folder):
        self.folder = folder
        self.scanner = self.start()
        self.database = Database(metadata_url(self.scanner.settings))  # of its own: the scanner's ends with its node
        self.row = ScannerRepository(self.database)
        self.row.ensure(simulated=True, address=self.scanner.url)
        self.other = ApiProcess(folder, role="api", node_secret=SECRET).wait()
        self.latch = EmergencyLatch(self.scanner.data.emergency)
        self.http = httpx.Client(base_url=f"{self.other.url}/api/v1", timeout=250)

    def start(self):
        return ApiProcess(self.folder, node_secret=SECRET).wait()

    def close(self):
        self.http.close()
        self.other.close()
        self.scanner.close()
        self.database.close()
