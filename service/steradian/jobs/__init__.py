"""Job queue: job model, ledger, DBOS queue, workers and task handlers.

Nothing is imported here: the queue's engine takes seconds to load and only those who need it pay.
"""
