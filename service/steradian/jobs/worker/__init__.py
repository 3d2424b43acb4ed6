"""Worker processes: polling, execution in child processes, results, failover."""
