"""Repositories: queries and changes of each resource's rows."""
