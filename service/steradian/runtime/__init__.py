"""Processes of the service: supervisor, acquisition, workers, backups."""
