"""ASGI middleware: authentication, cross-origin requests, response cache and validators."""
