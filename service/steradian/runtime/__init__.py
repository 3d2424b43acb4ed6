"""The processes of the service, their logs and their signs of life."""
