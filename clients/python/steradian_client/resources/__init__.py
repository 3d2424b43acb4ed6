"""One class per resource of the HTTP API."""
