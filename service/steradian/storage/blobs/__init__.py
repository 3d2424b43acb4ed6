"""Blob storage of scans, uploads and results: local folder or S3, with a local cache."""
