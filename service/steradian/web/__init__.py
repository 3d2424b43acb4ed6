"""Web page: HTML shells, styles and scripts; all data come from the HTTP API."""
