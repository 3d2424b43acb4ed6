"""Error responses: catalog of problems, exception handlers, field errors and the pages that explain them."""
