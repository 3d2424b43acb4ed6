"""A queue whose jobs do what they are told, and the diary in which each start of one notes its process."""

from functools import cached_property

from steradian.jobs.job import JobRequest
from steradian.jobs.queue.queue_client import JobQueue


class EchoQueue:
    """The client's side of a queue of such jobs."""

    def __init__(self, settings):
        self.settings = settings

    @cached_property
    def queue(self):
        return JobQueue(self.settings)

    def submit(self, name, do, **more):
        payload = {"do": do, "diary": str(self.settings.data / name), **more}
        return self.queue.submit(JobRequest(name, "echo", payload))

    def starts(self, name):
        """The process of each start of a job."""
        path = self.settings.data / name
        return [int(pid) for pid in path.read_text().split()] if path.exists() else []

    def close(self):
        if "queue" in vars(self):
            self.queue.close()
