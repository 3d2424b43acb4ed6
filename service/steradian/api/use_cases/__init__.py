"""Use cases that span several repositories: job admission, decommissioning of scanners."""
