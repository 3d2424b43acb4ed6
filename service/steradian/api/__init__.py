"""HTTP API: FastAPI application, routers, schemas and middleware."""
