"""API keys, sessions, scopes and rate limits."""
