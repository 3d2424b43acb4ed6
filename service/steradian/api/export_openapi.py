"""Export of the API's OpenAPI document to standard output."""

from __future__ import annotations

import json
import sys
import tempfile

from steradian.api.app import create_app
from steradian.core.settings import Settings


def main() -> None:
    """Write the OpenAPI document as JSON to standard output, for ``docs/openapi.json``."""
    with tempfile.TemporaryDirectory() as folder:
        app = create_app(Settings.create(data=folder))
        json.dump(app.openapi(), sys.stdout, indent=1, sort_keys=True, ensure_ascii=False)
        sys.stdout.write("\n")


if __name__ == "__main__":
    main()
