"""FastAPI routers, one module a resource."""
