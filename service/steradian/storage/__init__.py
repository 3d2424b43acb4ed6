"""What outlives a process: the metadata database, the data directory and the job queue.

Nothing is imported here: the queue's engine takes seconds to load and only those who need it pay.
"""
