"""The page for people: shells, styles and scripts; every figure on it comes from the HTTP API, as for any client."""
