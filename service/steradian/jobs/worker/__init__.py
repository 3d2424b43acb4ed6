"""Worker processes: polling of the queue, jobs in child processes, upload of results, failover."""
