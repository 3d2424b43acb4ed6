"""Persistence: metadata database, data directory, blob store and emergency-stop latch."""
