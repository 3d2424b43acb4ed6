"""``/metrics``: metrics in Prometheus's text format."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from prometheus_client import generate_latest

from steradian.api.middleware.authentication import AuthorizedRoute
from steradian.api.middleware.metrics import Metrics

router = APIRouter(tags=["health"], route_class=AuthorizedRoute)
TEXT = "text/plain; version=0.0.4; charset=utf-8"


@router.get(
    "/metrics",
    summary="Figures for Prometheus",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
def read_metrics(request: Request) -> Response:
    """Return Prometheus metrics: requests, jobs and scans in each state, workers and heartbeats."""
    metrics: Metrics = request.app.state.metrics
    return Response(generate_latest(metrics.registry), media_type=TEXT)
