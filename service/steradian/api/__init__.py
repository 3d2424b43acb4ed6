"""The HTTP service: one router a resource, one table of problems."""
