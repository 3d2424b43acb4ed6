"""Background components of the API process: periodic refresh, batching, process pool, peers, stop relay, retention."""
