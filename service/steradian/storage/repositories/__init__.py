"""Repositories: queries and updates of the database rows of each resource."""
