"""Resource collections of the client, one class per resource of the HTTP API."""
