"""Typed client of a Steradian service."""

from steradian_client.client import Client
from steradian_client.errors import ClientError, JobFailed, ServiceError, Unreachable
from steradian_client.models import Mask, Plan, Problem, Progress, Reconstruction, Scan

__all__ = [
    "Client",
    "ClientError",
    "JobFailed",
    "Mask",
    "Plan",
    "Problem",
    "Progress",
    "Reconstruction",
    "Scan",
    "ServiceError",
    "Unreachable",
]
