"""Server-sent events: broadcaster of the event log."""
