"""Job queue: client, ledger, fair queueing, estimates and the DBOS engine."""
