"""Path and query parameters, and FastAPI dependencies."""
