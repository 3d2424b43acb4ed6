"""What outlives a process: the metadata database, the data directory and the emergency stop's latch."""
