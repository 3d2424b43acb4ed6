"""Request and response schemas (pydantic models) of the API."""
