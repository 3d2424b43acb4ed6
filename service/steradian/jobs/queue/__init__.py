"""Job queue: client, ledger, fair queueing, estimates and the queue engine (DBOS)."""
