"""HTTP building blocks: bodies, conditional requests, ranges, cookies, headers, URLs and proxies."""
