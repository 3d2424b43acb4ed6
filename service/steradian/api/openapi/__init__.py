"""The OpenAPI document: post-processing, links and the documentation page."""
